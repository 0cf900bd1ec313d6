"""The simulated KUKA Sunrise controller: an arm with its drives, and on it the Sunrise Toolbox server application or
the rig's own robot application. It speaks their text lines on TCP."""
