"""Train double DQN in one loop, and save its policy as ``loop_dqn.onnx``."""

import copy

import numpy as np
import torch
from torch import nn

import flipperctl

STEPS, GAMMA, SEED = 20_000, 0.95, 1

rng = np.random.default_rng(SEED)
torch.manual_seed(SEED)
env = flipperctl.environment(terrain="uplift")
inputs, actions = env.observation_space.shape[0], env.action_space.n
hidden = [nn.Linear(inputs, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU()]
online = nn.Sequential(*hidden, nn.Linear(64, actions))
target = copy.deepcopy(online)
adam = torch.optim.Adam(online.parameters(), lr=1e-3)
replay = []
observation, _ = env.reset(seed=SEED)
for step in range(STEPS):
    if rng.random() < max(0.05, 1 - step / (0.3 * STEPS)):
        action = int(rng.integers(actions))
    else:
        with torch.no_grad():
            action = int(online(torch.from_numpy(observation)).argmax())
    after, reward, terminated, truncated, _ = env.step(action)
    replay.append((observation, action, np.float32(reward), after, terminated))
    observation = env.reset()[0] if terminated or truncated else after
    if step < 100:
        continue
    batch = [replay[i] for i in rng.integers(len(replay), size=32)]
    columns = zip(*batch, strict=True)
    now, taken, rewards, then, ended = (torch.from_numpy(np.array(x)) for x in columns)
    with torch.no_grad():
        best = online(then).argmax(1, keepdim=True)
        wanted = rewards + GAMMA * target(then).gather(1, best).squeeze(1) * ~ended
    values = online(now).gather(1, taken.unsqueeze(1)).squeeze(1)
    loss = nn.functional.smooth_l1_loss(values, wanted)
    adam.zero_grad()
    loss.backward()
    adam.step()
    if step % 500 == 0:
        target.load_state_dict(online.state_dict())
flipperctl.save(online, env, "loop_dqn.onnx", seed=SEED)
