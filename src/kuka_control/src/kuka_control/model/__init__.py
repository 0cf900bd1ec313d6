"""The arm with its tool: configuration, workspace, home position, the target chain, and studies of them.

Nothing here moves, sends or keeps time.
"""
