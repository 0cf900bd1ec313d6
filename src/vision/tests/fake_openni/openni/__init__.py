"""Stands for the package openni: a camera that a file tells what to do."""
