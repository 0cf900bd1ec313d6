"""The laboratory: recorded episodes, synthetic scenes, training and evaluation, and the programs that run them.

It uses the live half (network, pipeline, execution, ros); the live half never imports it.
"""
