"""Mutation testing: changes single places of the source, one at a time, and reports which changes the tests find."""
