"""The learner: replay, losses, schedules and the double dueling DQN."""
