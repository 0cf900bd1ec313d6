"""The camera: `camera` (driver, frames, depth in the colour image), `marker_board` (pose of the tags by colour and
depth), `calibration` (camera to arm, arm to arm), `stereo` (the view for the headset); nodes and programs in `ros`."""
