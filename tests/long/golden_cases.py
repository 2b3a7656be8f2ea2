"""What ``python -m tests.long.golden`` runs: commands and Python expressions by name.

Names are the keys of the written file, so that a command may change its spelling and keep its key.
A word with ``*`` is the first file that fits it. Expressions begin with ``flipperctl.``.
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
WALKS = {
    "random planar": ("", {}),
    "random lidar": ("", {"sim": "mujoco", "perception": "lidar"}),
    "loaded okada": ("okada", {}),
    "loaded generalist": ("generalist", {}),
}
"""Loaded policies, or none for random actions, and the arguments of the environment."""

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
    "resumed": "terrain=stair train.decisions=1500 train.regret_episodes=0",
    "whole": "terrain=stair train.decisions=1500 train.regret_episodes=0",
}
"""Overrides of ``train`` beside short budgets; ``resumed`` is stopped once and equals ``whole``."""


def training(name: str) -> str:
    """Return the command that trains one of them into the folder of its name."""
    own = {word.partition("=")[0] for word in TRAININGS[name].split()}
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
    "broken.py": "def broken(:\n",
    "fails.py": REWARD.replace("return -abs(", "raise ValueError('no pitch')  # "),
    "text.safetensors": "no weights",
    "text.onnx": "no network",
    "text.json": "{}",
    "odd.yaml": "scenes: [1]\n",
    "suite.yaml": "about: Two of my own.\nscenes:\n  low: terrain=step terrain.height=[-0.4,0.1]\n"
    "  far: terrain=gap,ramp sim.friction=0.7\n",
    "file": "",
}
"""Files that commands read."""

NEEDED = ("paper", "risk", "sweep")
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
        "--by steps+up,friction --output by",
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
        "audit": f"{_RETURNS} --controller okada terrain=stair --episodes 5 {_REWARD}",
        "regret": f"{_RETURNS} --controller okada --regret --against level terrain=stair,ramp "
        "--episodes 8",
        "compare": f"{_RETURNS} --compare level,okada,generalist terrain=step,ramp "
        "rewards=paper,smooth --episodes 6",
        "python": 'flipperctl.evaluate("paper", terrain=["stair", "gap"], episodes=5, '
        'baselines=["level"], by=["steps"], progress=False).to_dict()',
        "config": "inspect config --json",
        "terrain": "inspect terrain building_stair --json",
    },
    {
        "methods": "compare seeds --against okada --json",
        "results": "compare several --measure t_cost --price 60 --json",
        "replay": "replay --json several/failure_*.json",
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

REFUSALS = """
: trian | new terrian mine | new terrain My-Name | new reward pitch | bench nope | inspect nope
eval: | --controler okada | --controller okado | --controller generalist | --checkpoint okada
eval --checkpoint: nowhere | text.safetensors | cut.safetensors | flipped.safetensors | text.onnx
eval --checkpoint paper: conditions=trianed | agent.gamma=0.5 | robot.chassis_mass=-1
eval --controller okada: terrain=stiar | terrain=stair,step,stiar | terrain=null | friction=1
eval --controller okada: terrain=stair terrain.rise=-1 | train.decisions=5 | sim.friction=slippery
eval --controller okada: randomise.sim.friction=true | conditions=trained | --friction 0.6
eval --controller okada: --episodes 0 | --episodes x | --episodes 3 eval.episodes=4 | --seed -1
eval --controller okada: --baseline levl | --baseline none,okada | --passable generalist | --jobs 0
eval --controller okada terrain=step: --by hieght | --film x.png
map okada terrain=step: | --over terrain.height=0.1 | --over terrain.hihgt=0:1,sim.friction=0.4:1
eval --controller okada: --output file/out | suite=nope | suite=odd.yaml
eval --controller okada: --plugins nowhere.py | --plugins broken.py | controller.faar=1
eval --controller okada: --plugins fails.py +reward@rewards.calm=calm terrain=step --episodes 1
replay: text.json | nowhere.json
train: terrain=stiar | terain=stair | terrain stair | seed=1,2 | agent.gamma=1.5 | agent.gama=0.9
train: experiment=nope | rewards.pitch.lamda_2=3 | +reward@rewards.x=pich | ~rewards | rewards=tunde
train: network=at_d3q | device=gpu | teacher=okdaa | agent.start_from=nowhere | --resume nowhere
train: hydra.run.dir=paper | hydra.run.dir=file/run | --resume sweep
train: -m seed=1,2 agent.gamma=0.9,7 | --resume paper agent.gamma=0.9
compare: nowhere
card: nowhere | paper nowhere
export onnx: nowhere | paper --output no/x.onnx | okada
export: onxx paper | onnx paper --output calm.py
robot ground: nowhere --output x.xyz | file --output x.xyz
robot shadow: nowhere.onnx nowhere | text.onnx nowhere
robot: check nowhere | self-test nowhere | shadow
inspect: plugins stiar | terrain stiar | terrain stair --output x.bmp | reward --compare okada
inspect: checkpoint nowhere | checkpoint flipped.safetensors | run sweep
inspect: config agent.gama=1
flipperctl.evaluate: ("okado") | ("okada", terrain="stiar") | ("okada", episodes=0)
flipperctl.evaluate: ("okada", baselines="level") | ("cut.safetensors") | ("okada", by=["hight"])
flipperctl.train: (terrain="stiar") | (train={"decisons": 5}) | (resume="nowhere") | (device="gpu")
flipperctl.load: ("nope") | ("okada", faar=0.8) | ("text.onnx") | ("generalist", far=0.8)
"""
"""Beginnings and, between bars, what follows each: requests that are wrong."""
