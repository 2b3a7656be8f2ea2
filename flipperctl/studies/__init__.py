"""Studies of policies and engines: transfer, engine comparison, rewards, conventions."""
