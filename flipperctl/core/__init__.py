"""What a robot computes, in numpy alone: observations, actions, targets, and a map of the ground.

The environment and ``flipperctl.runtime`` both import it, so that the simulator and a robot cannot
differ. It imports nothing else of flipperctl.
"""
