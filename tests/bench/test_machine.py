"""Description of the machine."""

from flipperctl import __version__
from flipperctl.bench.settings import machine, processor


def test_versions_processor_and_load_are_noted() -> None:
    found = machine()
    assert found["versions"]["flipperctl"] == __version__
    assert found["versions"]["torch"]
    assert found["cores"] >= 1
    assert found["processor"]
    assert found["date"].startswith("20")


def test_the_processor_is_the_model_not_the_architecture(tmp_path) -> None:
    listing = tmp_path / "cpuinfo"
    listing.write_text("processor\t: 0\nmodel\t\t: 85\nmodel name\t: Fast CPU @ 2 GHz\n")
    assert processor(listing) == "Fast CPU @ 2 GHz"
