"""The programs run_policy.py and train_policy.py."""
