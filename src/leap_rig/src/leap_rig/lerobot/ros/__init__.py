"""The program lerobot_server.py."""
