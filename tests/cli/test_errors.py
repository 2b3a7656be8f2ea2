"""Bad input: exit code 2, one or two lines with the fault and what is allowed; no files."""

import os
import shutil
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.agent import replay as memory
from tests.cli.call import RUN, call, refused


@pytest.fixture(autouse=True)
def _eight_gigabytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the free memory, independent of the machine."""
    monkeypatch.setattr(memory, "available", lambda: 8_000_000_000)


QUICK = [f"{key}={value}" for key, value in RUN.items()]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["trian"], ["trian", "train"]),
        (["eval", "--controler", "okada"], ["--controler", "--controller"]),
        (["train", "--multrun"], ["--multrun", "--multirun"]),
        (["train", "--experimental-rerun", "x.pickle"], ["--experimental-rerun"]),
        (["train", "stair"], ["'stair'", "key=value"]),
        (["train", "terrain", "=", "stair"], ["terrain =: write key=value without spaces"]),
        (["train", "terrain=corduroy"], ["'corduroy'; a plugin of your own", "--plugins FILE"]),
        (["inspect", "terrain", "terrain=stair"], ["write stair, without terrain="]),
        (["inspect", "plugins", "mine.py"], ["its file as --plugins mine.py"]),
        (["export", "onnx", "runs/mine"], ["write --checkpoint runs/mine"]),
        (["card", "--checkpoint", "runs/mine"], ["write runs/mine alone"]),
        (["train", "--checkpoint", "runs/mine"], ["agent.start_from=runs/mine begins with"]),
        (["inspect", "plugins", "terrain=stair"], ["write stair, without terrain="]),
        (["eval", "--controller", 300 * "a"], ["a plugin of your own is loaded by --plugins"]),
        (
            ["eval", "--controller", "level", "train.decisions=5"],
            ["train.decisions: it belongs to a training, and has no meaning here"],
        ),
        (["train", "+train.validation_episodes=3"], ["exists already; write it without +"]),
        (["train", "collector.max_lag=3"], ["collector has no settings here"]),
        (["inspect", "run", "nope"], ["nope holds no metrics.csv; there is no such folder"]),
        (["new"], ["'KIND'", "see flipperctl new --help"]),
        (["export"], ["Choose from: onnx, pt2", "see flipperctl export --help"]),
        (["train", "terrain=step seed=3"], ["several overrides", "out: terrain=step seed=3"]),
        (["train", "seed=1,2"], ["seed=1,2: several values", "add -m"]),
        (["train", "gamma=0.9"], ["gamma: there is no such key; did you mean agent.gamma?"]),
        (["eval", "--controller", "level", "friction=1"], ["did you mean ", "sim.friction"]),
        (["train", "controller=okada"], ["controller: there is no such key", "teacher"]),
        (["eval", "runs/x"], ["runs/x", "no such run", "generalist"]),
        (["train", "hydra.run.dir="], ["hydra.run.dir", "the value is ''"]),
        (["train", "hydra.run.dir=null"], ["hydra.run.dir", "the value is None"]),
        (["train", "-m", "seed=1,2", "hydra.sweep.dir="], ["hydra.sweep.dir"]),
        (["train", "hydra.run.dir=sp", "ace/x"], ["""'hydra.run.dir="sp ace/x"'"""]),
        (["train", "hydra.run.dir=a(b"], ["""'hydra.run.dir="a(b"'"""]),
        (["inspect", "config", "=3"], ["'=3' has no key"]),
        (["inspect", "config", "terrain=3"], ["terrain: a name", "3"]),
        (["inspect", "config", "network=[1,2]"], ["network: a name", "[1, 2]"]),
        (["eval", "--controller", "level", "terrain=null"], ["terrain=null", "give a name"]),
        (["train", "terain=stair"], ["terain", "'terrain'"]),
        (["train", "terrain=stiar"], ["terrain", "'stiar'", "'stair'"]),
        (["train", "network=at_d3q"], ["network", "'at_d3qn'"]),
        (["train", "experiment=nope"], ["experiment", "nope"]),
        (["train", "+reward@rewards.x=pich"], ["reward", "'pitch'"]),
        (["train", "agent.gama=0.9"], ["agent.gama", "'gamma'"]),
        (["train", "rewards.pitch.lamda_2=3"], ["rewards.pitch.lamda_2", "'lambda_2'"]),
        (["train", "~rewards.pich"], ["rewards.pich", "'pitch'"]),
        (["train", "rewards=tunde"], ["rewards", "'tunde'", "'tuned'", "paper, smooth, tuned"]),
        (["train", "rewards.pich.weight=2"], ["rewards.pich.weight", "'pitch'", "in rewards"]),
        (["train", "rewards=tuned", "rewards.travle.weight=2"], ["rewards.travle", "'travel'"]),
        (
            ["train", "+reward@rewards.way=shaped_progress", "agent.gamma=0.95"],
            ["rewards.way.gamma: 0.99", "agent.gamma (0.95)", "set rewards.way.gamma=0.95"],
        ),
        *(
            (["train", word], ["rewards.hit: there is no such key", "write +reward@rewards.hit=im"])
            for word in ("reward@rewards.hit=impact", "rewards.hit=impact")
        ),
        *(
            (["train", word], ["rewards.impact: there is no", "+reward@rewards.impact=impact"])
            for word in ("reward=impact", "rewards.impact=impact")
        ),
        (["train", "rewards.impact.weight=2"], ["write +reward@rewards.impact=impact"]),
        (
            ["train", "+reward@rewards.hit=impact", "rewards.hit.wieght=2"],
            ["rewards.hit.wieght", "'weight'", "known in rewards.hit: "],
        ),
        (
            ["train", "+reward@rewards.pitch=impact"],
            ["rewards.pitch exists already", "write reward@rewards.pitch=impact"],
        ),
        *(
            (["train", "~rewards.pitch", word], ["~rewards.pitch", "write reward@rewards.pitch=im"])
            for word in ("+reward@rewards.pitch=impact", "reward@rewards.pitch=impact")
        ),
        (["train", "+terrain=step"], ["terrain exists already", "write terrain=step"]),
        (["train", "terrain=step", "terrain.hihg=0.2"], ["terrain.hihg", "'high'"]),
        (["train", "+agent.gama=0.9"], ["agent.gama", "'gamma'"]),
        (["train", "agent.gamma=1.5"], ["agent.gamma", "< 1", "1.5"]),
        (["train", "terrain.fewest=many"], ["terrain.fewest", "integer", "'many'"]),
        (["train", "terrain.fewest=6"], ["fewest (6) must not exceed most (5)"]),
        (["train", "terrain.rise=-0.1"], ["terrain.rise", "> 0", "-0.1"]),
        (["train", "rewards.pitch.lambda_2=inf"], ["rewards.pitch.lambda_2", "finite"]),
        (["train", "rewards={}"], ["rewards={}", "~rewards drops every term"]),
        (["train", "~rewards"], ["rewards:", "a training needs a term", "none"]),
        (
            ["train", "~rewards.flipper", "~rewards.pitch", "rewards.end.weight=0"],
            ["a training needs a term whose weight is not 0", "end"],
        ),
        (
            ["train", "network.terrain=[100000,100000]"],
            ["'at_d3qn'", "10,014,534,826 parameters", "240.3 GB", "6 times 40.1 GB", "are free"],
        ),
        (
            [
                *("train", "agent.replay_size=10000000", "train.decisions=1000000000"),
                *("perception.bins=101", "network=stacked", "network.window=16"),
            ],
            ["agent.replay_size", "10,000,000 transitions of 1664 numbers", "133.3 GB"],
        ),
        (
            ["train", "agent.batch_size=65536", "network.terrain=[50000,100]"],
            ["agent.batch_size", "65,536", "GB"],
        ),
        (
            ["eval", "--controller", "planner", "controller.widht=5"],
            ["controller.widht", "'width'", "budget"],
        ),
        (["train", "sim.substep=0.003"], ["sim", "substep must divide 0.01"]),
        (["train", "device=gpu"], ["device", "'gpu'"]),
        (["train", "-m", "seed=1,2", "agent.gamma=0.9,7"], ["agent.gamma", "7"]),
        (["train", "--resume", "nowhere"], ["nowhere", "no such run"]),
        (["train", "--plugins", "nowhere.py"], ["nowhere.py", "does not exist"]),
        (["eval"], ["name a policy, as in: flipperctl eval generalist terrain=stair"]),
        (["eval", "--controller", "okado"], ["okado: there is no", "'okada'"]),
        (["eval", "--controller", "okada", "--baseline", "levl"], ["'levl'", "'level'"]),
        *(
            (["eval", "--controller", "okada", f"randomise.{key}=true"], [key, "rue"])
            for key in ("friction", "robot.payload")
        ),
        *(
            (["eval", *words, "generalist"], [words[-1], "add --checkpoint generalist"])
            for words in (
                ["--controller", "okada", "--baseline"],
                ["--controller", "okada", "--passable"],
                ["--controller", "okada,level", "--baseline"],
            )
        ),
        (
            ["eval", "--controller", "okada", "--baseline", "none,okada"],
            ["--baseline: none stands alone", "none,okada"],
        ),
        (["eval", "--controller", "okada", "--passable", "okada,"], ["--passable", "'okada,'"]),
        (["eval", "--controller", "okada", "--episodes", "0"], ["eval.episodes", "≥ 1"]),
        (["eval", "--controller", "okada", "--episodes", "x"], ["eval.episodes", "'x'"]),
        (
            ["eval", "--controller", "okada", "conditions=wet.yaml"],
            ["'wet'", "conditions of your own are overrides", "suite=FILE.yaml"],
        ),
        (["eval", "--checkpoint", "nowhere"], ["nowhere: there is no", "controller", "generalist"]),
        (["export", "onxx", "--checkpoint", "x"], ["onxx", "onnx"]),
        (["export", "onnx", "--checkpoint", "nowhere"], ["nowhere"]),
        (["inspect", "plugins", "stiar"], ["'stiar'", "'stair'"]),
        (["inspect", "terrain", "stiar"], ["'stiar'", "'stair'"]),
        (["inspect", "terrain", "stair", "--output", "x.bmp"], ["x.bmp", ".png"]),
        (["inspect", "terrain", "stair", "--output", "no/x.png"], ["no/x.png", "no folder"]),
        (["inspect", "checkpoint", "nowhere"], ["nowhere"]),
        (["inspect", "run", "nowhere"], ["nowhere", "metrics.csv"]),
        (["inspect", "config", "agent.gama=1"], ["'gamma'"]),
    ],
    ids=" ".join,
)
def test_a_wrong_request_is_named(arguments: list[str], words: list[str], tmp_path: Path) -> None:
    error = refused(*arguments, cwd=tmp_path)
    assert [word for word in words if word not in error] == [], error


def test_an_existing_run_is_never_overwritten(short_run: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(short_run, tmp_path / "run"))
    (run / "config.yaml").write_text("mine")
    done = call("train", *QUICK, f"hydra.run.dir={run}", cwd=tmp_path)
    assert done.code == 2
    assert "already holds a run" in done.err
    assert (run / "config.yaml").read_text() == "mine"
    best = checkpoint.BEST
    assert (run / best).read_bytes() == (short_run / best).read_bytes()


@pytest.mark.parametrize("words", [["--cfg", "job"], ["--multirun"]])
def test_resume_neither_prints_nor_sweeps(
    words: list[str], short_run: Path, tmp_path: Path
) -> None:
    error = refused("train", "--resume", str(short_run), *words, cwd=tmp_path)
    assert f"{words[0]}: no meaning beside --resume" in error


def test_the_folder_of_a_sweep_is_no_run(tmp_path: Path) -> None:
    run = tmp_path / "sweep" / "0_seed=1"
    run.mkdir(parents=True)
    (run / "config.yaml").write_text("seed: 1")
    for command in (["inspect", "run", "sweep"], ["train", "--resume", "sweep"]):
        error = refused(*command, cwd=tmp_path)
        assert "give one of its runs, such as sweep/0_seed=1" in error


def test_resume_keeps_the_configuration(short_run: Path, tmp_path: Path) -> None:
    error = refused("train", "--resume", str(short_run), "agent.gamma=0.9", cwd=tmp_path)
    assert "keeps its configuration" in error
    weights = str(short_run / checkpoint.BEST)
    assert "holds only the weights" in refused("train", "--resume", weights, cwd=tmp_path)


@pytest.mark.parametrize("command", ["eval", "export", "inspect", "resume"])
@pytest.mark.parametrize("damage", ["flipped", "truncated", "pickle"])
def test_a_damaged_checkpoint_is_refused_by_every_command(
    command: str, damage: str, short_run: Path, tmp_path: Path
) -> None:
    path = tmp_path / "c.safetensors"
    data = bytearray((short_run / checkpoint.BEST).read_bytes())
    data[len(data) // 2] ^= 4
    contents = {"flipped": bytes(data), "truncated": bytes(data[:900]), "pickle": b"\x80\x04N."}
    path.write_bytes(contents[damage])
    arguments = {
        "eval": ["eval", "--checkpoint", str(path)],
        "export": ["export", "onnx", "--checkpoint", str(path)],
        "inspect": ["inspect", "checkpoint", str(path)],
        "resume": ["train", "--resume", str(path)],
    }[command]
    error = refused(*arguments, cwd=tmp_path)
    assert str(path) in error
    assert ("pickle" if damage == "pickle" else "damaged") in error


def test_an_output_that_cannot_be_written_is_refused(short_run: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    run = str(short_run)
    (tmp_path / "metrics.csv").write_text("kind,decision\n")
    for arguments in (
        ["export", "onnx", "--checkpoint", run, "--output", "file/x.onnx"],
        ["export", "onnx", "--checkpoint", run, "--output", "no/x.onnx"],
        ["export", "onnx", "--checkpoint", run, "--output", "."],
        ["eval", "--checkpoint", run, "--episodes", "1", "--output", "file/out"],
        ["inspect", "run", ".", "--output", "file/x.png"],
        ["train", *QUICK, "hydra.run.dir=file/run"],
    ):
        assert "cannot be written" in refused(*arguments, cwd=tmp_path)


def test_debug_shows_the_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from flipperctl.errors import ConfigError

    monkeypatch.setenv("FLIPPERCTL_DEBUG", "1")
    with pytest.raises(ConfigError):
        call("train", "agent.gamma=7", cwd=tmp_path)
    assert os.environ["FLIPPERCTL_DEBUG"] == "1"
