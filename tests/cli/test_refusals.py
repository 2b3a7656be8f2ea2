"""Requests that are refused: exit code 2, one or two lines, and nothing is left behind.

Each row is a command and the parts of its error. The folder holds an empty file named file.
"""

import shlex
from pathlib import Path

import pytest

import flipperctl
from flipperctl.agent import replay as memory
from flipperctl.config import EnvConfig, parse, to_dict
from flipperctl.errors import FlipperctlError
from tests.cli.call import refused

REFUSED = """
trian -> trian | train
eval okada randomise.friction=[0.6,1] -> did you mean randomise.sim.friction?
eval level terrain=step,stair --film f.gif -> --film shows one scene; 2
eval level terrain=step --episode 3 -> --episode is of a film
eval level terrain=step --film f.gif --speed 0.3 -> multiples of 0.25
eval level terrain=step --film f.gif --episodes 2 --episode 5 -> 0 to 1 is evaluated
train terrain=step,stair -m --film f.gif -> multirun: no meaning beside --film
train terrain=step --film f.txt -> f.txt
train terrain=step --film f.gif train.validate_every=10 -> --film shows at most 30 validations
eval okada sim=planar,planar -> another engine is compared with planar
eval okada conditions=trained -> no checkpoint is evaluated; known: nominal
train conditions=null -> conditions=null: a name is allowed
train agent=sb4 -> there is no agent plugin 'sb4' | d3qn, policy_gradient, sb3
train method=sb3 -> method: a learner is chosen by its name, agent=NAME (d3qn, policy_gradient, sb3)
train agent=sb3 agent.algorithm=sac -> actions: turns does not go with | actions=rates is allowed
train actions=rates -> actions: rates does not go with agent=d3qn | flipperctl list learners
train agent=sb3 network=dueling_mlp -> dueling_mlp does not go with | network=mlp is allowed
train agent=sb3 teacher=okada -> teacher: agent=sb3 learns from rewards alone; set teacher=none
train agent=sb3 train.mode=exact -> train.mode=exact: it has no effect with agent=sb3
train agent=sb3 agent.settings.tau=5 -> agent.settings.tau: ≥ 0, ≤ 1 is allowed; the value is 5
train agent=sb3 agent.settings.gamma=0.9 -> it is the run's; set agent.gamma
train agent=sb3 agent.settings.train_freq=[1,"day"] -> agent.settings: DQN refuses them
inspect reward conditions=nominal,varied -> takes one scene
eval okada terrain=stair,stair -> is given twice; once is allowed
eval planner okada controller.smoothness=9 -> controller.smoothness | known in controller=okada:
eval okada terrain=step terrain.height=[0.3,0.1] -> terrain.height | low ≤ high | [0.3, 0.1]
eval okada terrain=step terrain.height=0.3 episode.run_up=0.2 -> overlaps the robot at the start
inspect plugins flat --output x -> --output needs --check
train --experimental-rerun x.pickle -> --experimental-rerun
train terrain = stair -> 'terrain' is no override; write key=value without spaces
train terrain=corduroy -> 'corduroy'; a plugin of your own | --plugins FILE
eval --controller level train.decisions=5 \
    -> train.decisions: it belongs to a training, and has no meaning here
train collector.max_lag=3 -> collector=local has no settings here
inspect run nope -> nope holds no metrics.csv; there is no such folder
train 'terrain=step seed=3' -> 'terrain=step seed=3': Hydra cannot read this override
train agent.gamma=1.5 -> agent.gamma: 1.5 is not allowed (≥ 0, < 1)
train robot.angle_step=15deg -> '15deg' is no number (> 0, ≤ 1.5708 rad)
train train.best_by=luck -> 'luck' is not allowed ('success', 'return' or 'last')
train --algo sac -> no such option: --algo (here it is agent=sb3 agent.algorithm=sac actions=rates)
train agent=sac -> 'sac' (here it is agent=sb3 agent.algorithm=sac actions=rates)
train agent.algorithm=sac -> agent.algorithm: there is no such key (agent=sb3 has it)
list terrains --pictures -> --pictures FILE: FILE is missing; see flipperctl list --help
robot identify -> Missing argument 'BAG'; see flipperctl robot identify --help
train seed=1,2 -> seed=1,2: several values | add -m
eval --controller level friction=1 -> did you mean  | sim.friction
train controller=okada -> controller: there is no such key | teacher
eval runs/x -> runs/x | no such run | generalist
train +reward@rewards.way=shaped_progress agent.gamma=0.95 \
    -> rewards.way.gamma: 0.99 | agent.gamma (0.95) | set rewards.way.gamma=0.95
train +terrain=step -> terrain exists already | write terrain=step
train '~rewards' -> rewards: | a training needs a term | none
train rewards=paper '~rewards.flipper' '~rewards.pitch' rewards.end.weight=0 \
    -> a training needs a term whose weight is not 0 | end
train agent.replay_size=10000000 train.decisions=1000000000 perception.bins=101 \
    network=stacked network.window=16 \
    -> agent.replay_size | 10,000,000 transitions of 3280 numbers | 266.2 GB
eval --controller planner controller.widht=5 -> controller.widht | 'width' | budget
train sim.substep=0.003 -> sim | substep must divide 0.01
train --resume nowhere -> nowhere | no such run
replay nowhere.json -> nowhere.json: it cannot be read | No such file
eval -> name a policy, as in: flipperctl eval generalist terrain=stair
eval --controller okada --baseline generalist -> --baseline | name it as a policy beside
eval --controller okada --baseline none,okada -> --baseline: none stands alone | none,okada
eval --controller okada conditions=wet.yaml -> 'wet' | known: nominal
eval --checkpoint nowhere -> nowhere: there is no | controller | generalist
list terain -> there is no kind 'terain' | 'terrains' | known: terrains, rewards
list stair -> flipperctl explain stair
explain agent.gama -> 'agent.gama' (did you mean 'agent.gamma'?
eval okada,level --record e.safetensors terrain=flat -> --record takes one policy
eval level --record e.safetensors eval.ray=auto terrain=flat \
    -> eval.ray: no meaning beside --record
eval okada terrain=stair --by step -> --by: no scene draws 'step' (did you mean 'steps'?
map okada terrain=uplift -> name two settings, as in --over terrain.height=
map okada terrain=uplift --over perception.occlusion,sim.friction -> it is no number
map okada terrain=uplift --over terrain.height=1:0,sim.friction -> from a lower to a higher number
map okada terrain=uplift randomise.sim.friction=[0.8,1.2] --over terrain.height,sim.friction \
    -> --over sim.friction: it has no effect
map okada terrain=uplift --over terrain.height=0.2:0.5:2,sim.friction=0.5:1.0:2 sim=planar,mujoco \
    -> map takes one scene; the settings give 2
tune -> tune takes one controller, as in: flipperctl tune okada
tune level terrain=stair -> level: this controller has no number between two bounds to tune
tune okada budget=100 terrain=stair -> budget: at least 187 episodes are needed | is 100
tune okada --for reward '~rewards' -> --for reward: there is no reward term
tune hfc terrain=stair -> hfc learns from demonstrations; add from=POLICY or a folder of drives
tune okada from=level -> from=level: okada takes no demonstrations here; leave it out
inspect reward --regret -> --regret: name a policy
inspect reward level generalist --regret perception.bins=9 -> bins=15
inspect reward level okada controller=level -> the policies are named by words
inspect reward level okada '~rewards' -> leaves no term
inspect reward level value_iteration terrain=step rewards=paper,smooth \
    -> value_iteration drives otherwise for each of the rewards paper, smooth
new terrain 'My Own' -> 'My Own' | lower-case letters
new reward signal -> 'signal' | standard library | signal_reward is free
new terrain torch -> 'torch' | the package torch | torch_terrain is free
new terrain stair -> 'stair' | already | stairs.py:
bench --small decisions -> 'decisions' | did you mean 'decision'
train seed=1,2 -> several values make several runs; add -m
train -m hydra.mode=RUN seed=1,2 -> hydra.mode=RUN: no meaning beside --multirun
train -m 'seed=glob(*)' -> seed=glob(*): no name fits
train --output a hydra.run.dir=b -> hydra.run.dir=b: no meaning beside --output
train --output a --resume b -> --output: no meaning beside --resume
train agent.learning_rate=true -> agent.learning_rate: a number is allowed
train --terrain stair -> --terrain; policies are words, and settings key=value
train --out here -> (did you mean '--output'?
eval okada --seed 3 eval.seed=4 \
    -> eval.seed is given twice: --seed 3 and eval.seed=4; one is allowed
map okada --over=seed,seed --episodes 3 ++eval.episodes=4 \
    -> eval.episodes is given twice: --episodes 3 and ++eval.episodes=4; one is allowed
eval --controller okada controller=level \
    -> controller is given twice: controller=okada and controller=level; one is allowed
train agent.gamma=0.9 +agent.gamma=0.8 \
    -> agent.gamma is given twice: agent.gamma=0.9 and +agent.gamma=0.8; one is allowed
train ~rewards.pitch reward@rewards.pitch=impact \
    -> rewards.pitch is given twice: ~rewards.pitch and reward@rewards.pitch=impact
watch --no-open -> name a policy
drive --as ../x --no-open -> --as '../x'
drive --study none.yaml --no-open -> --study none.yaml cannot be read
drive --output file --no-open -> it is a file
"""


def requests() -> list[tuple[str, list[str]]]:
    lines = [line for line in REFUSED.splitlines() if line]
    halves = [line.split(" -> ") for line in lines]
    return [(command.strip(), parts.split(" | ")) for command, parts in halves]


@pytest.fixture(autouse=True)
def _eight_gigabytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the free memory, independent of the machine."""
    monkeypatch.setattr(memory, "available", lambda: 8_000_000_000)


@pytest.mark.parametrize(("command", "parts"), requests())
def test_a_wrong_request_is_named(command: str, parts: list[str], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    error = refused(*shlex.split(command), cwd=tmp_path)
    assert [part for part in parts if part not in error] == [], error


@pytest.mark.parametrize("command", ["inspect terrain profile_file", "train terrain=profile_file"])
def test_ground_without_a_file_is_refused_before_any_seed(command: str, tmp_path: Path) -> None:
    error = refused(*command.split(), cwd=tmp_path)
    assert error.rstrip().endswith("Name its file, such as terrain.path=ground.csv")


def test_paths_of_every_kind_of_door_may_begin_with_the_home_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home, here = tmp_path / "home", tmp_path / "here"
    home.mkdir()
    here.mkdir()
    monkeypatch.setenv("HOME", str(home))
    for words in (
        ["train", "--resume=~/none"], ["eval", "~/none.onnx", "--output=~/x"],
        ["eval", "okada", "terrain=profile_file", "terrain.path=~/none.csv"],
        ["plot", "METHOD=~/none"], ["list", "terrains", "--plugins=~/none.py"],
        ["robot", "check", "~/none"], ["eval", "okada", "robot=~/none.yaml"],
    ):  # fmt: skip
        assert f"{home}/none" in refused(*words, cwd=here), words
    plain = {"terrain": {"name": "profile_file", "path": "~/none.csv"}}  # as of a file
    assert to_dict(parse(EnvConfig, plain))["terrain"]["path"] == f"{home}/none.csv"
    with pytest.raises(FlipperctlError, match=f"{home}/none"):
        flipperctl.load("~/none.onnx")
    with pytest.raises(FlipperctlError, match=f"{home}/none"):
        flipperctl.environment(terrain={"name": "profile_file", "path": "~/none.csv"}).reset()
    assert list(here.iterdir()) == []
