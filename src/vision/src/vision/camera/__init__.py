"""The RGB-D camera: its frames, its driver library, the health of its streams, and depth registered to colour."""
