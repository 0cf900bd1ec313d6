"""The door to ROS 2, of two processes with a socket between them: `wire` (its frames), `channels` (what passes),
`outbox` (what waits), `key_values` (messages that ROS 2 does not know), `conversions` (bytes, in ROS 2's
environment)."""
