"""The command-line programs of the package; here files are read and written."""
