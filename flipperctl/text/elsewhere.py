"""Words of other tools, and what is typed here in their place."""

from __future__ import annotations

_WORDS = {
    "agent=NAME": "algo algorithm",
    "agent.learning_rate": "lr",
    "agent.replay_size": "buffer_size replay_buffer memory_size",
    "agent.target_rate": "tau polyak",
    "agent.epsilon_end": "exploration_final_eps final_epsilon",
    "agent.temperature": "ent_coef entropy",
    "train.decisions": "total_timesteps timesteps n_timesteps",
    "collector.workers": "n_envs num_envs n_actors",
    "train.validate_every": "eval_freq eval_interval",
    "train.checkpoint_every": "save_freq checkpoint_freq",
    "terrain=NAME": "env env_id environment heightfield",
    "terrain=profile_file terrain.path=FILE": "heightmap height_map dem point_cloud",
    "randomise.…": "domain_randomization domain_randomisation dr",
    "watch, or eval --film FILE": "enjoy play render visualize visualise",
    "eval --film FILE": "video record_video gif animation film",
    "train --resume RUN": "resume continue load_checkpoint warm_start",
    "agent.start_from=RUN": "pretrained finetune fine_tune init_from",
    "train -m seed=1,2 hydra/launcher=submitit_slurm": "slurm sbatch cluster",
    "logger=wandb": "wandb_project",
    "pitch variation, θ̂_R": "theta_r theta θ_r",
    "agent.trace": "gae_lambda",
    "agent=policy_gradient": "ppo",
    "agent.gamma": "γ discount",
    "rewards.flipper.lambda_1": "λ1 λ_1 lambda1",
    "rewards.pitch.lambda_2": "λ2 λ_2 lambda2",
    "robot=FILE": "urdf mjcf",
    "export onnx": "torchscript jit deploy",
    "examples/docker/Dockerfile": "docker dockerfile",
}
HERE = {word: ours for ours, words in _WORDS.items() for word in words.split()}
"""A word of another tool → what is typed here."""


def here(word: str) -> str | None:
    """Return what stands for another tool's word, such as ``lr`` or ``--env-id``."""
    return HERE.get(word.lstrip("-").lower().replace("-", "_").replace(" ", "_"))


def called_here(word: str) -> str:
    """Return `` (here it is …)`` for another tool's word; empty for any other."""
    ours = here(word)
    return f" (here it is {ours})" if ours else ""
