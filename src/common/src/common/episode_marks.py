"""What an operator says of an episode that is recorded for training; each mark is also a service, as episodes/begin."""

BEGIN, SUCCESS, FAILURE, DISCARD, AGAIN = "begin", "success", "failure", "discard", "again"
MARKS = BEGIN, SUCCESS, FAILURE, DISCARD, AGAIN
"""`again`: discard the episode, and begin another one."""
