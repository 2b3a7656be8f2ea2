"""The network ``near_far`` for flipperctl; importing this package registers it."""

from flipperctl_near_far.near_far import NearFar

__all__ = ["NearFar"]
