"""What ``python -m tests.long.golden`` runs: commands of a shell by name.

Names are the keys of the written file, so that a command may change its spelling and keep its key.
"""

GROUNDS = "step,stair,building_stair,ramp,uplift,gap,wave,rubble,pallet,plum"
_ALL = f"terrain={GROUNDS}"
_LIDAR = "sim=mujoco perception=lidar"
_SMALL = "--controller mpc controller.beam=3 controller.horizon=4"

EPISODES = {  # those that take longest first
    "generalist lidar": f"--checkpoint generalist {_ALL} {_LIDAR} --episodes 1",
    "mpc planar": f"--controller mpc {_ALL} --episodes 1",
    "mpc mujoco": f"{_SMALL} {_ALL} sim=mujoco --episodes 1",
    "small mpc planar": f"{_SMALL} {_ALL} --episodes 2",
    "mpc lidar": f"{_SMALL} terrain=gap,ramp {_LIDAR} --episodes 1",
    "generalist mujoco": f"--checkpoint generalist {_ALL} sim=mujoco --episodes 2",
    "okada lidar": f"--controller okada {_ALL} {_LIDAR} --episodes 1",
    "okada mujoco": f"--controller okada {_ALL} sim=mujoco --episodes 2",
    "generalist planar": f"--checkpoint generalist {_ALL} --episodes 4",
    "okada planar": f"--controller okada {_ALL} --episodes 5",
    "okada widest": f"--controller okada {_ALL} conditions=widest --episodes 1",
    "okada occluded": f"--controller okada {_ALL} perception.occlusion=true --episodes 1",
}
"""Arguments of ``eval``, about 200 episodes."""

_SHORT = (
    "train.mode=exact train.decisions=300 train.validate_every=150 train.checkpoint_every=100 "
    "train.validation_episodes=2 train.regret_episodes=1 agent.learning_starts=100 "
    "agent.epsilon_decisions=200"
)
_TEACHER = "teacher.controller.beam=2 teacher.controller.horizon=2"
_SEARCH = (
    "terrain=flat terrain.length=0.1 episode.run_up=0.3 episode.run_out=0.3 "
    "teacher.controller.groups=6 teacher.controller.horizon=1 teacher.controller.beam=1 "
    "teacher.batch_groups=4 teacher.kept_groups=10 network.terrain=[8] network.fused=8 "
    "network.head=8 train.decisions=40 train.validate_every=20 train.checkpoint_every=20 "
    "agent.learning_starts=4 agent.batch_size=8"
)
TRAININGS = {
    "paper": "experiment=paper terrain=stair",
    "precise": "experiment=precise terrain=step rewards=smooth",
    "searched": f"experiment=searched {_SEARCH}",
    "taught": f"experiment=taught {_TEACHER} terrain=ramp agent.batch_size=32",
    "distilled": "experiment=distilled teacher.controller.policy=generalist teacher.final_updates=8"
    " agent.batch_size=32",
    "refined": "experiment=refined agent.decisions=100 agent.batch_size=64",
    "risk": "terrain=plum agent.risk=true agent.risk_horizon=8",
    "sweep": "-m terrain=step seed=1,2 train.regret_episodes=0",
}
"""Overrides of ``train`` beside short budgets."""


def training(name: str) -> str:
    """Return the command that trains one of them into the folder of its name."""
    own = {word.partition("=")[0] for word in TRAININGS[name].split()}
    if "experiment=refined" in TRAININGS[name]:  # another learner
        own |= {"agent.learning_starts", "agent.epsilon_decisions"}
    short = [word for word in _SHORT.split() if word.partition("=")[0] not in own]
    folder = "hydra.sweep.dir" if name == "sweep" else "hydra.run.dir"
    return f"train {TRAININGS[name]} {' '.join(short)} {folder}={name}"


REWARD = """from flipperctl import api


@api.reward("calm")
class Calm(api.RewardTerm):
    '''Penalise the pitch.'''

    def __call__(self, t: api.Transition) -> float:
        return -abs(float(t.after.pitch))
"""
FILES = {
    "calm.py": REWARD,
    "suite.yaml": "about: Two of my own.\nscenes:\n  low: terrain=step terrain.height=[-0.4,0.1]\n"
    "  far: terrain=gap,ramp sim.friction=0.7\n",
}
"""Files that commands read."""

NEEDED = {name: training(name) for name in ("paper", "risk", "sweep")}
"""Trainings whose runs the evaluations and exports read."""
_OKADA = "eval --json --controller okada"
_REWARD = "+reward@rewards.calm=calm --plugins calm.py"
_RETURNS = "inspect reward --json"
_SEVERAL = (
    "eval --json --controller okada,level --checkpoint generalist terrain=stair,plum "
    "--output several"
)
EVALUATIONS = (
    {
        "one": "eval --json --checkpoint paper --baseline okada,level terrain=stair,step "
        "--episodes 12",
        "several": f"{_SEVERAL} --episodes 8",
        "seeds": "eval --json --checkpoint sweep --controller okada terrain=stair,ramp "
        "--episodes 6 --output seeds",
        "by": f"{_OKADA} --baseline level terrain=stair conditions=varied --episodes 24 "
        "--by steps+up,sim.friction --output by",
        "suite": f"{_OKADA},level suite=suite.yaml --episodes 4",
        "shipped suite": f"{_OKADA} suite=families --episodes 2",
        "passable": "eval --json --controller level terrain=plum --passable okada --episodes 12",
        "wide": "eval --json --checkpoint generalist --baseline okada conditions=nominal,wide "
        "terrain=gap --episodes 5 --output wide",
        "mujoco": f"{_OKADA} --baseline level sim=mujoco terrain=stair --episodes 4",
        "risk": "eval --json --checkpoint risk terrain=plum,stair --episodes 8 --jobs 2",
        "trained": "eval --json --checkpoint generalist conditions=trained --episodes 2 --jobs 2",
        "plugin": f"{_OKADA} {_REWARD} terrain=step --episodes 6",
        "map": "map --json okada terrain=uplift "
        "--over terrain.height=0.2:0.5:3,sim.friction=0.5:1:2 --episodes 2",
        "transfer": "eval --json okada sim=planar,mujoco terrain=stair,plum --episodes 3",
        "transfer lidar": "eval --json okada sim=planar,mujoco terrain=gap perception=lidar "
        "--episodes 1",
        "audit": f"{_RETURNS} okada terrain=stair --episodes 5 {_REWARD}",
        "regret": f"{_RETURNS} okada level --regret terrain=stair,ramp --episodes 8",
        "compare": f"{_RETURNS} level okada generalist terrain=step,ramp "
        "rewards=paper,smooth --episodes 6",
        "config": "inspect config --json",
        "terrain": "inspect terrain building_stair --json",
    },
    {
        "methods": "compare seeds --against okada --json",
        "results": "compare several --measure t_cost --price 60 --json",
        "replay": "replay --json $(ls several/failure_*.json | head -n 1)",
        "again": f"{_SEVERAL} --episodes 10",
        "run": "inspect run risk --json",
        "checkpoint": "inspect checkpoint risk --json",
    },
)
"""Commands that print JSON; the second ones read what the first ones wrote."""

EXPORTS = {
    "generalist": "export onnx generalist --output generalist.onnx",
    "paper": "export onnx paper --output paper.onnx",
    "risk": "export onnx risk --output risk.onnx robot.flipper_speed=0.5",
    "mjcf": "export mjcf terrain=stair --seed 3 --output stair.xml",
    "urdf": "export urdf terrain=stair robot=absolem --output absolem.urdf",
}

PARTS = {
    "episodes": (
        {
            name: f"eval {words} --seed 5 --baseline none --json --output '{name}'"
            for name, words in EPISODES.items()
        },
    ),
    "trainings": ({name: training(name) for name in TRAININGS},),
    "evaluations": (NEEDED, *EVALUATIONS),
    "export": (NEEDED, EXPORTS),
}
"""Part → batches of commands; those of a batch run at the same time."""
