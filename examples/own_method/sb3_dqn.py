"""Train DQN of Stable-Baselines3, and save its policy as ``sb3_dqn.onnx``."""

from stable_baselines3 import DQN

import flipperctl

SETTINGS = {
    "learning_rate": 1e-3,
    "train_freq": 1,
    "gamma": 0.95,
    "learning_starts": 1_000,
    "target_update_interval": 500,
    "exploration_fraction": 0.3,
}
env = flipperctl.environment(terrain="uplift")
model = DQN("MlpPolicy", env, **SETTINGS, seed=1)
model.learn(20_000)
flipperctl.save(model.q_net, env, "sb3_dqn.onnx", seed=1)
