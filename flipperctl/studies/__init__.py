"""Studies that play episodes to answer a question: transfer, engines, rewards, conventions."""
