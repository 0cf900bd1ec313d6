"""The Leap Motion controller: frames of its service as records, and a client that always has the newest."""
