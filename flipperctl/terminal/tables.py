"""What commands print of a policy, a terrain, settings, plugins, a recording or measures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl.api import Robot
from flipperctl.text.messages import percent, spans, unit
from flipperctl.text.show import NONE, Column, Table, console, print_lines, print_table, print_text

_PLUGINS = (
    Column("kind", "kind"),
    Column("name", "name", named=True),
    Column("source", "source"),
)
_CHECKS = (
    Column("plugin", "plugin", named=True),
    Column("check", "check", wrapped=True),
    Column("state", "ok"),
    Column("seconds", "time [s]"),
)


def print_plugins(plugins: list[dict[str, Any]]) -> None:
    """Print a line for each plugin."""
    print_table(Table(_PLUGINS, plugins), console())


def print_checks(rows: Sequence[dict[str, Any]]) -> None:
    """Print a row for each check, and below them the messages."""
    output = console()
    cells = []
    last = ""
    for row in rows:
        plugin = f"{row['kind']} {row['name']}"
        state = "skipped" if row["skipped"] else "yes" if row["ok"] else "no"
        style = "bold red" if state == "no" else ""
        shown = {"plugin": "" if plugin == last else plugin, "state": state, "style": style}
        cells.append(row | shown)
        last = plugin
    print_table(Table(_CHECKS, cells), output)
    for row in rows:
        if row["message"]:
            print_lines(output, f"{row['check']}: {row['message']}".split("\n"))


_PROFILES = (
    Column("seed", "seed", named=True),
    Column("length", "length [m]", 3),
    Column("lowest", "lowest [m]", 3),
    Column("highest", "highest [m]", 3),
    Column("climb", "end above start [m]", 3),
    Column("largest_face", "largest vertical face [m]", 3),
    Column("steepest_slope_degrees", "steepest slope [°]", 3),
    Column("drawn", "drawn", wrapped=True),
)


def print_terrain(name: str, numbers: list[dict[str, Any]], picture: Path | None) -> None:
    """Print a row for each profile (``figures.terrain.sample``), and the picture's name."""
    # Seeds of the same ground share a row.
    seeds: dict[str, list[int]] = {}
    cells: dict[str, dict[str, Any]] = {}
    for row in numbers:
        drawn = ", ".join(f"{name} {value:.4g}" for name, value in row["drawn"].items())
        key = f"{row['points']} {drawn}"
        seeds.setdefault(key, []).append(row["seed"])
        cells.setdefault(key, row | {"drawn": drawn})
    rows = [row | {"seed": spans(seeds[key])} for key, row in cells.items()]
    if len(numbers) > len(rows) == 1:
        rows[0]["seed"] = "any"  # nothing about the terrain is random
    columns = [column for column in _PROFILES if any(row[column.key] for row in rows)]
    print_table(Table(columns, rows, name), console())
    if any(row["points_drawn"] > len(row["points"]) for row in numbers):
        most = max(row["points_drawn"] for row in numbers)
        print_text(
            f"sampled with up to {most} points; points too fine for a track to feel are left out"
        )
    if picture is not None:
        print_text(f"picture: {picture}")


_FOUND = (Column("what", "what", named=True), Column("found", "found", wrapped=True))
_POSES = {
    "true": "the poses of the recording",
    "belts": "odometry by belts and inertial unit",
    "matched": "odometry, corrected by matching",
}


def print_perception(perception: dict[str, Any], output: Path | None) -> None:
    """Print how a robot's sensing fared on its recording; ``output`` was written."""
    # Scans and estimates: used, refused, or held on a robot
    rows = {"scans used": str(perception["scans"])}
    rows["scans refused"] = str(sum(refusal["count"] for refusal in perception["refused"].values()))
    for name, refusal in perception["refused"].items():
        rows[f"  {name}"] = f"{refusal['count']}: {refusal['reason']}"
    rows["estimates"] = str(perception["decisions"])
    rows |= {f"  would hold: {name}": str(count) for name, count in perception["held"].items()}
    # How much ground was seen, and how certain its heights are
    coverage, deviation = perception["coverage"], perception["deviation"]
    rows["bins seen"] = f"{percent(coverage['mean'])}, at least {percent(coverage['least'])}"
    rows["ground filled"] = percent(perception["filled"])
    rows["σ of a height"] = NONE if deviation is None else f"{1000 * deviation:.0f} mm (median)"
    # What computing takes
    for name, key in (("an estimate", "estimate_ms"), ("a scan", "scan_ms")):
        times = perception[key]
        rows[f"{name} takes"] = f"{times['p50']:.1f} ms, p99 {times['p99']:.1f} ms"
    rows["scans enter at"] = _POSES[perception["pose"]]
    # The drift, if the recording has poses of its own
    if (drift := perception["drift"]) is not None:
        share = drift["share"]
        of = "" if share is None else f" ({percent(share)} of {drift['way']:.2f} m)"
        rows["drift"] = (
            f"{1000 * (drift['horizontal'] or 0.0):.0f} mm{of}, height "
            f"{1000 * (drift['height'] or 0.0):+.0f} mm, heading "
            f"{math.degrees(drift['heading'] or 0.0):+.1f}° against the recording"
        )
    last = None if output is None else f"written: {output}"
    _print_recording("perception", str(perception["source"]), perception, rows, last)


_COMPARED = (
    Column("quantity", "quantity", named=True),
    Column("first", "A"),
    Column("second", "B"),
    Column("largest", "difference"),
    Column("allowed", "allowed"),
    Column("verdict", "verdict"),
)


def _print_checks(rows: Sequence[dict[str, Any]]) -> None:
    """Print what independent measurements of each quantity differ by."""
    cells = []
    for row in rows:
        unit, style = "" if row["unit"] == "1" else f" {row['unit']}", "bold red"
        shown = {"largest": f"{row['difference']:.3g}{unit}", "allowed": f"{row['warn']:g}{unit}"}
        cells.append(row | shown | {"style": "" if row["verdict"] == "ok" else style})
    if cells:
        print_table(Table(_COMPARED, cells, "cross-checks"), console())


def print_shadow(shadow: dict[str, Any]) -> None:
    """Print how a policy fared on a recording in shadow mode, and where its log is."""
    rows = {"decisions": str(shadow["decisions"])}
    rows |= {state: f"{seconds:.1f} s" for state, seconds in shadow["states"].items()}
    for name, fault in shadow["faults"].items():
        rows[f"  {name}"] = f"{fault['count']} ×, {fault['seconds']:.1f} s: {fault['reason']}"
    who = f"{shadow['policy']} on {shadow['source']}"
    _print_recording("shadow mode", who, shadow, rows, f"log: {shadow['output']}")


def print_field_drive(document: dict[str, Any]) -> None:
    """Print what was measured of each drive of a bag, and where the record is."""
    rows: dict[str, str] = {}
    for number, drive in enumerate(document["drives"]):
        rows[f"drive {number}"] = (
            f"{drive['outcome']}, {drive['decisions']} decisions in {drive['t_cost']:.1f} s from "
            f"{drive['start']:.1f} s on"
        )
        rows[f"{number}: pitch variation, largest pitch"] = (
            f"{drive['pitch_variation']:.2f} rad, {drive['max_pitch']:.2f} rad"
        )
        rows[f"{number}: travel of the flippers"] = f"{drive['flipper_travel']:.2f} rad"
        rows[f"{number}: way of the belts, share they stood"] = (
            f"{drive['way_of_belts']:.2f} m, {percent(drive['belts_stood'])}"
        )
        rows[f"{number}: ground seen"] = percent(drive["seen"])
    who = f"{document['driver']} in {document['source']}"
    last = f"record: {document['output']}; it has neither rewards nor the true ground"
    _print_recording("field drive", who, document, rows, last)


def print_identified(document: dict[str, Any]) -> None:
    """Print the values of a robot that a bag tells, and where its file is."""
    rows = {
        f"{key} [{value['unit']}]": f"{value['interval']}: {value['why']}"
        for key, value in document["values"].items()
    }
    last = None if document["output"] is None else f"written: {document['output']}"
    _print_recording("identified (95 %)", str(document["source"]), document, rows, last)


def _print_recording(
    title: str, who: str, recording: dict[str, Any], rows: Mapping[str, str], last: str | None
) -> None:
    topics = ", ".join(f"{device} {topic}" for device, topic in recording["topics"].items())
    print_text(f"{who}: {recording['seconds']:.1f} s; {topics}")
    cells = [{"what": what, "found": text} for what, text in rows.items()]
    print_table(Table(_FOUND, cells, title), console())
    _print_checks(recording["checks"])
    for remark in recording["remarks"]:
        print_text(remark)
    if last is not None:
        print_text(last)


def print_export(target: Path, source: Path, exported: dict[str, Any]) -> None:
    """Print how far the file ``target`` agrees with torch, and for which other robot it is."""
    print_text(
        f"{target}: {exported['bytes']} bytes, from {source}\n"
        f"compared with torch on {exported['observations']} observations of rollouts: "
        f"outputs of up to {exported['largest_q_value']:.2g} differ by at most "
        f"{exported['largest_difference']:.2g} (allowed {exported['allowed_difference']:.2g}), "
        f"the chosen action agrees on {100 * exported['action_agreement']:.4g} %"
    )
    parts = []
    for name, values in exported["robot_changes"].items():
        setting = name in Robot.model_fields
        label = f"robot.{name}" if setting else name.replace("_", " ")
        file, training = (
            "null" if value is None else f"{value:.6g}"
            for value in (values["file"], values["training"])
        )
        of = unit(Robot, name) if setting else "s"
        parts.append(f"{label} {file} {of} (training {training})")
    if parts:
        print_text(f"for another robot than that of the training: {', '.join(parts)}")


def print_scene(scene: dict[str, Any]) -> None:
    """Print which files of a scene were written, and where the robot starts in it."""
    x, y, z = scene["start"]
    print_text(
        f"{' and '.join(scene['output'])}: {scene['terrain']}, seed {scene['seed']}, "
        f"{scene['boxes']} boxes of ground\n"
        f"the robot starts at x {x:.3f}, y {y:.3f}, z {z:.3f} m"
    )


def print_bag(bag: dict[str, Any]) -> None:
    """Print which episode a bag holds, and how many messages of each topic."""
    print_text(
        f"wrote {bag['output']}: {bag['terrain']}, seed {bag['seed']}, {bag['outcome']} "
        f"after {bag['seconds']:.2f} s"
    )
    for topic, count in sorted(bag["messages"].items()):
        print_text(f"  {topic}: {count}")


_SIMULATED = (
    Column("episode", "episode", named=True),
    Column("outcome", "outcome"),
    Column("pitch_variation_100hz", "pitch variation [rad]", 2),
    Column("seconds", "time [s]", 1),
    Column("median", "cloud to command [ms]", 0),
    Column("most", "99 % [ms]", 0),
    Column("used", "node's core [%]", 0),
    Column("told", "told most", wrapped=True),
)


def print_simulated(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print how the episodes of a simulated robot on topics went."""
    cells = []
    for row in rows:
        most = max(row["diagnoses"], key=row["diagnoses"].get, default="nothing")
        times = {"median": 1e3 * row["latency_median"], "most": 1e3 * row["latency_99"]}
        used = row["processor_share"] and 100 * row["processor_share"]
        cells.append({**row, **times, "used": used, "told": most, "episode": str(row["episode"])})
    print_table(Table(_SIMULATED, cells), console())


def print_vectors(written: Mapping[str, Any]) -> None:
    """Print how many instants a file of vectors has."""
    print_text(
        f"wrote {written['output']}: {written['instants']} instants of {written['episodes']} "
        f"episodes of {written['terrain']}"
    )


def print_ground(ground: dict[str, Any]) -> None:
    """Print what recorded ground covers, and how to drive over it."""
    without = f" ({ground['clouds_without_pose']} more have no pose)"
    each = ground["points_per_cloud"]
    _print_checks(ground["checks"])
    for remark in ground["remarks"]:
        print_text(remark)
    along = "" if ground["start"] is None else f", along {ground['length']:.2f} m"
    print_text(
        f"{ground['output']}: {ground['points']} points of {ground['clouds']} clouds"
        f"{without if ground['clouds_without_pose'] else ''} with {each['least']} to "
        f"{each['most']} points each{along}"
    )
    if ground["start"] is not None:
        (x0, y0), (x1, y1) = ground["start"], ground["end"]
        print_text(
            "drive over it: flipperctl eval level terrain=profile_file "
            f"terrain.path={ground['output']} 'terrain.start=[{x0},{y0}]' 'terrain.end=[{x1},{y1}]'"
        )
