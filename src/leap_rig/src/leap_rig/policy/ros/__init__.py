"""The program run_policy.py."""
