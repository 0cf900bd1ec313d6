"""The rig as URDF: arms, media flanges and hand in numbers, and the text and meshes made of them."""
