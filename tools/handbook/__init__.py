"""Checks what the hand-written pages say: their links, and the commands that they show."""
