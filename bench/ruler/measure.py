"""Runs the program under test on every machine and collects all that it says, as tables."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ruler import machines
from ruler.program import ProgramError, Request, command, load_model, predicted
from ruler.tables import Table, from_csv, from_folder, from_json

MACHINES = ("tk6920", "spindle", "joint", "separate")


@dataclass
class Bench:
    """A folder to work in, with the stored `inputs` and `models` in it; the tables found so far, and what failed."""

    work: Path
    data: Path
    tables: dict[str, Table] = field(default_factory=dict)
    trained: dict[str, Path] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    @property
    def inputs(self) -> Path:
        """The machine folders that all versions are given."""
        return self.work / "inputs"

    @property
    def models(self) -> Path:
        """The stored models of format 1, by machine."""
        return self.work / "models"

    def copy(self, machine: str) -> Path:
        """A copy of a stored machine folder to run commands on."""
        return Path(shutil.copytree(self.inputs / machine, self.work / machine))

    def tell(self, name: str, *arguments: str | Path) -> None:
        """Run a command and keep what it says, under `name`, and the files in its folder `--out`."""
        words = [str(part) for part in arguments]
        try:
            self.tables |= from_json(f"{name}.json", command(self.work, *words))
        except ProgramError as exc:
            self.failures.append(str(exc))  # the other commands are still worth running
            return
        if "--out" in words:
            out = self.work / words[words.index("--out") + 1]
            self.tables |= from_folder(name, out) if out.is_dir() else {f"{name}.csv": from_csv(out)}

    def predict(self, name: str, model: Path, requests: Sequence[Request]) -> None:
        """Predictions in full precision, each a table under `name`."""
        try:
            loaded = load_model(model)
            for request in requests:
                columns = predicted(loaded, request)
                columns["axis"] = list(request.axis) or ["volume"] * len(request.t_s)
                self.tables[f"{name}/{request.name}"] = Table("full", columns, ("axis",))
        except Exception as exc:  # whatever a version under test raises is a finding, not the end of the ruler
            self.failures.append(f"{name}: {type(exc).__name__}: {exc}")

    def train(self, machine: str, model: str) -> list[Request]:
        """Note the model that a version has just made of a machine, and predict from it; what was asked."""
        requests = requests_of(self, machine)
        self.trained[machine] = self.work / model
        self.predict(f"{machine}/prediction", self.trained[machine], requests)
        return requests

    def predict_by_command(self, machine: str, requests: Sequence[Request]) -> None:
        """The same predictions as a user asks for them, from files to a file."""
        for request in requests:
            name = f"{machine}/predict/{request.name}"
            files = Path(f"asked-{machine}") / request.name.replace(" ", "_")
            options = machines.write_request(request, self.work / files)
            options = [Path(o).relative_to(self.work) if isinstance(o, Path) else o for o in options]
            model = self.trained[machine].relative_to(self.work)
            self.tell(name, "predict", model, *options, "--out", files / "prediction.csv")


def requests_of(bench: Bench, machine: str) -> list[Request]:
    """What is asked of the models of a machine."""
    if machine == "tk6920":
        return machines.tk6920_requests(bench.inputs / machine)
    if machine == "spindle":
        return machines.spindle_requests(bench.data / machines.RECORDING)
    return machines.virtual_requests(machine, bench.inputs / machine, volume=machine == "joint")


def measure_stored(bench: Bench) -> None:
    """The stored models of format 1: as they are, and the laws that they hold besides the one in use."""
    for machine in MACHINES:
        requests, model = requests_of(bench, machine), bench.models / f"{machine}.json"
        for name, path in {"prediction": model, **machines.variants(model, bench.work)}.items():
            # The examples have no sensor that could stand for a workpiece.
            if machine in machines.VIRTUAL or name != "length of the workpiece":
                bench.predict(f"stored/{machine}/{name}", path, requests)


def measure_twin(bench: Bench) -> None:
    """The virtual machines themselves: what was measured on them."""
    for name in machines.VIRTUAL:
        bench.tables |= from_folder(f"twin/{name}", machines.make_virtual(name, bench.work))


def measure_tk6920(bench: Bench) -> None:
    """The bundled example, as the demo runs it."""
    document = command(bench.work, "demo", "--out", "demo")
    for step in document["steps"]:
        bench.tables |= from_json(f"tk6920/{step['command'][0]}.json", step)
    for name in ("results", "sinumerik"):
        bench.tables |= from_folder(f"tk6920/{name}", bench.work / "demo" / name)
    for name in ("equations_compared.csv", "prediction.csv"):
        bench.tables[f"tk6920/{name}"] = from_csv(bench.work / "demo" / name)
    bench.train("tk6920", "demo/results/model.json")


def measure_spindle(bench: Bench) -> None:
    """The spindle recording: drift, heat history, the spindle speed."""
    folder = bench.copy("spindle")
    shutil.copy(bench.data / machines.RECORDING, folder / "data.xlsx")
    bench.tell("spindle/analyze", "analyze", "spindle", "--out", "spindle-results")
    requests = bench.train("spindle", "spindle-results/model.json")
    bench.predict_by_command("spindle", requests[2:3])


def measure_joint(bench: Bench) -> None:
    """A virtual machine in the joint form, with every command that there is for a machine folder."""
    folder = bench.copy("joint")
    machines.with_angles(folder)
    bench.tell("joint/check", "check", "joint")
    bench.tell("joint/analyze", "analyze", "joint", "--out", "joint-results")
    requests = bench.train("joint", "joint-results/model.json")
    bench.predict_by_command("joint", [requests[1], requests[6]])
    model = "joint-results/model.json"
    bench.tell("joint/export", "export", model, "--target", "sinumerik", "--out", "joint-control", "--replay", "joint")
    bench.tell("joint/keypoints", "keypoints", "joint")
    bench.tell("joint/keypoints exact", "keypoints", "joint", "--method", "exact", "--sensors", "2")
    bench.tell("joint/iso230", "iso230", "joint", "--out", "joint-iso")
    bench.tell("joint/plan", "plan", "joint", "--out", "joint-plan")
    *off, last = machines.campaigns_of(folder)
    machines.add_compensated(folder, last)
    given = [word for name in off for word in ("--off", name)]
    bench.tell("joint/verify", "verify", "joint", *given, "--on", "on", "--model", model, "--out", "joint-verification")


def measure_separate(bench: Bench) -> None:
    """A virtual machine in the separate form, with faulty sensors and a campaign that is only tested."""
    folder = bench.copy("separate")
    machines.without_places(folder)
    first, second, third = machines.campaigns_of(folder)
    bench.tell("separate/check", "check", "separate")
    given = ("--mix", "--train", first, "--train", second, "--test", third)
    bench.tell("separate/analyze", "analyze", "separate", "--out", "separate-results", *given)
    requests = bench.train("separate", "separate-results/model.json")
    bench.predict_by_command("separate", [requests[2]])
    model = "separate-results/model.json"
    bench.tell("separate/export", "export", model, "--target", "sinumerik", "--out", "separate-control")
    bench.tell("separate/keypoints paper", "keypoints", "separate", "--method", "paper", "--mix")
    machines.add_compensated(folder, third)
    bench.tell("separate/verify", "verify", "separate", "--off", first, "--on", "on", "--out", "separate-verification")


MEASURES: dict[str, Callable[[Bench], None]] = {
    "stored": measure_stored,
    "twin": measure_twin,
    "tk6920": measure_tk6920,
    "spindle": measure_spindle,
    "joint": measure_joint,
    "separate": measure_separate,
}
