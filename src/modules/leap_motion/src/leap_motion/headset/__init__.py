"""Hands that a headset's browser tracks (WebXR), served as the Leap service serves them; needs numpy and websockets.
`placement` says where the virtual Leap is, `hand_stream` makes frames of the page's messages, `transport` is the
conversation with the page, in which service/access.py decides who may drive."""
