"""A library for learners: networks, replay, losses, curiosity, the risk of failing."""
