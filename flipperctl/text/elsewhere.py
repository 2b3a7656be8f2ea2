"""Words of other tools: what they mean here, and what is typed in their place."""

from __future__ import annotations

import re
from dataclasses import dataclass

_TEXT = """
algo, algorithm: The learner; flipperctl list learners | agent=NAME
ppo: Proximal policy optimisation, of this package or of Stable-Baselines3
    | agent=policy_gradient | agent=sb3 agent.algorithm=ppo
dqn: Q-learning: by default a double dueling DQN, or that of Stable-Baselines3
    | agent=d3qn | agent=sb3 agent.algorithm=dqn
a2c: Advantage actor-critic of Stable-Baselines3 | agent=sb3 agent.algorithm=a2c
sac: Soft actor-critic of Stable-Baselines3 | agent=sb3 agent.algorithm=sac actions=rates
td3: Twin delayed DDPG of Stable-Baselines3 | agent=sb3 agent.algorithm=td3 actions=rates
ddpg: Deterministic policy gradient of Stable-Baselines3
    | agent=sb3 agent.algorithm=ddpg actions=rates
bc, imitation, behavior_cloning: A training that begins with a teacher's actions | teacher=okada
lr: | agent.learning_rate
buffer_size, replay_buffer, memory_size: | agent.replay_size
tau, polyak: | agent.target_rate
exploration_final_eps, final_epsilon: | agent.epsilon_end
ent_coef, entropy: | agent.temperature
gae_lambda: | agent.trace
γ, discount: | agent.gamma
λ1, λ_1, lambda1: | rewards.flipper.lambda_1
λ2, λ_2, lambda2: | rewards.pitch.lambda_2
theta_r, theta, θ_r: | pitch variation
total_timesteps, timesteps, n_timesteps: | train.decisions
n_envs, num_envs, n_actors: | train.workers
eval_freq, eval_interval: | train.validate_every
save_freq, checkpoint_freq: | train.checkpoint_every
pretrained, finetune, fine_tune, init_from: | agent.start_from
gpu: | device
env, env_id, environment, heightfield: The ground; flipperctl list terrains | terrain=NAME
heightmap, height_map, dem, point_cloud: Recorded ground, as .npy, .csv, GeoTIFF, a mesh or a cloud
    | terrain=profile_file terrain.path=FILE
domain_randomization, domain_randomisation, dr: A setting that is sampled for each episode
    | randomise.SETTING=[LOW,HIGH]
wandb_project: Weights & Biases | logger=wandb
urdf, mjcf: A robot's file of settings, which states its dimensions | robot=FILE
enjoy, play, render, visualize, visualise: A policy drives in a browser, or in a film
    | flipperctl watch POLICY | flipperctl eval POLICY --film FILE
video, record_video, gif, animation, film: A film of an episode, as .gif or .mp4
    | flipperctl eval POLICY --film FILE
teleop, keyboard, gamepad, joystick: You drive, by hand | flipperctl drive terrain=NAME
resume, continue, load_checkpoint, warm_start: A stopped training goes on
    | flipperctl train --resume RUN
outdir, out_dir, output_dir, logdir, log_dir, save_path: The folder for results | --output DIR
slurm, sbatch, cluster: Several trainings as jobs of Slurm
    | flipperctl train -m seed=1,2 hydra/launcher=submitit_slurm
csv, pandas, dataframe: Tables of episodes and means, in a folder
    | flipperctl eval POLICY --output DIR
latex: A table of methods for a paper | flipperctl compare DIR --output methods.tex
leaderboard: Frozen scenes with fixed prices | flipperctl benchmark POLICY
torchscript, jit, deploy: A file that numpy and onnxruntime run on a robot
    | flipperctl export onnx POLICY --output FILE
gym, gymnasium: The task as an environment, in Python
    | gymnasium.make("flipperctl.env:flipperctl/Flipper-v0", terrain="stair")
notebook, jupyter, colab: Notebooks with figures, in a clone's examples/notebooks
    | jupyter lab examples/notebooks/first.ipynb
docker, dockerfile: An image with torch's CPU build, in a clone
    | docker build -f examples/docker/Dockerfile -t flipperctl .
"""


@dataclass(frozen=True)
class Foreign:
    """A word of another tool."""

    meaning: str
    """Empty for a word whose setting, or word of ours, explains itself."""
    ours: tuple[str, ...]
    """What is typed here: settings, options or whole lines; of the glossary, a word."""

    @property
    def lines(self) -> tuple[str, ...]:
        """Whole lines to type."""
        return tuple(
            f"flipperctl train {text}" if re.match(r"[\w.]+=|--", text) else text
            for text in self.ours
        )


def _words() -> dict[str, Foreign]:
    words: dict[str, Foreign] = {}
    for entry in re.findall(r"^\S.*(?:\n +.*)*", _TEXT, re.MULTILINE):
        names, _, rest = entry.partition(":")
        meaning, *ours = (" ".join(part.split()) for part in rest.split("|"))
        words |= dict.fromkeys(names.split(", "), Foreign(meaning, tuple(ours)))
    return words


WORDS = _words()
"""A word of another tool → what it is here."""


def here(word: str) -> Foreign | None:
    """Return what stands for another tool's word, such as ``lr`` or ``--env-id``."""
    return WORDS.get(word.lstrip("-").lower().replace("-", "_").replace(" ", "_"))


def called_here(word: str) -> str:
    """Return `` (here it is …)`` for another tool's word; empty for any other."""
    foreign = here(word)
    return f" (here it is {', or '.join(foreign.ours)})" if foreign else ""
