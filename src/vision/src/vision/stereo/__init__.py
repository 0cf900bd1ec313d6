"""The view for a headset: one image for each eye by depth-image-based rendering, and the lenses of the Rift DK2."""
