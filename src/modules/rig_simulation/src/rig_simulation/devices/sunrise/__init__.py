"""The simulated KUKA Sunrise controller: an arm with its drives, and the Sunrise Toolbox server application on it. It
speaks the toolbox's text lines on TCP."""
