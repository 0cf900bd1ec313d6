"""The arm with its tool: configuration, workspace, home position, the target chain, and studies of them."""
