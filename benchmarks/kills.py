"""Every command that writes: killed, on a full disk, in a folder that cannot be written, renamed, or started twice.

    python benchmarks/kills.py                                   every command, 6 trials of each trouble: about an hour
    python benchmarks/kills.py --trials 20 --command track       one command, longer
    python benchmarks/kills.py --trials 1 --command new --command export --trouble killed     a run to see that it runs

Real processes and real SIGKILLs at random moments. After each: no half-written file under a final name, no traceback;
the command run again ends well, with the files of a run that nobody disturbed, and without temporary files. The
labelling page's server is killed between its edits: every edit that it acknowledged is still there.

A full disk is a tmpfs of its own where it can be mounted, otherwise a limit on the size of files.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import h5py
import numpy as np
from label_server import Page
from safetensors.numpy import load_file

from bendtrack import model_folders, training
from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.models.inference.checksum import check_checksum
from bendtrack.models.inference.runtime import engine_record, is_whole
from bendtrack.models.training.state import STATE_FILE
from bendtrack.reporting import SilentReporter
from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.hashing import file_sha256
from bendtrack.tracker.project import Project
from bendtrack.tracker.video_writer import VideoWriter

BENDTRACK = Path(sys.executable).parent / "bendtrack"
KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
SIZE_WH = (96, 72)
TRAINING = {"init": '"random"', "steps": 6, "batch_frames": 1, "held_out": 0.2}
LONGEST_S = 600
TEMPORARY = re.compile(r"^\..*\.tmp|\.partial$|\.staging")
TROUBLES = ("killed", "full", "read-only", "renamed", "twice")


@dataclass(frozen=True)
class Command:
    """A command that writes.

    Attributes
    ----------
    arguments : str
        As typed, with {} in front of every path.
    needs : tuple of str
        Files and folders of the prepared desk.
    adds : bool
        Whether each run adds to what is there, so that two leave more than one; what was there before must stay.
    again : str
        What a person types after it was stopped; empty where that is the same.
    """

    arguments: str
    needs: tuple[str, ...] = ()
    again: str = ""
    adds: bool = False


COMMANDS = {
    "new": Command("new {}fresh"),
    "frames": Command("frames {}labelled {}film.mp4 --count 4", ("labelled", "film.mp4"), adds=True),
    "import": Command("import {}fresh {}labelled", ("labelled",)),
    "export": Command("export {}labelled {}out --format dlc", ("labelled",)),
    "export-coco": Command("export {}labelled {}out --format coco", ("labelled",)),
    "train": Command(
        "train {}labelled --name net", ("labelled",), again="train {}labelled --name net --overwrite"
    ),
    # A kill between the network and its figures leaves nothing to resume: the network is there, and is evaluated.
    "resume": Command("train {}stopped --resume", ("stopped",), again="evaluate {}stopped"),
    "evaluate": Command("evaluate {}trained", ("trained",)),
    "track": Command("track {}trained {}film.mp4 --overlay", ("trained", "film.mp4")),
    "compile": Command("track {}plain {}film.mp4 --engine openvino", ("plain", "film.mp4")),
    "angle": Command("angle {}film.mp4 --out {}out --quick", ("film.mp4",)),
    "first-study": Command("analyze --init {}rig", ("rig",)),
    "analyze": Command("analyze {}rig2/study.toml --out {}out", ("rig2",)),
    "render": Command(
        "render {}out --cycles 1 --frequency-hz 2 --labels 4 --size 160x120 --end-vector-px 12"
    ),
    "label": Command("label {}labelled --no-browser", ("labelled",)),
}


# --- a desk with all that the commands need ----------------------------------------------------------------


def arm(angle_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """A picture of a bent arm, RGB, and its four points (4, 2) px."""
    turn = np.radians(angle_deg)
    base = np.array([[12.0, 22.0], [30.0, 22.0]])
    tip = base[1] + 16 * np.array([np.cos(turn / 2), np.sin(turn / 2)])
    xy = np.stack([*base, tip, tip + 18 * np.array([np.cos(turn), np.sin(turn)])])
    image = np.full((SIZE_WH[1], SIZE_WH[0], 3), 70, np.uint8)
    cv2.polylines(
        image, [np.round(xy * 8).astype(np.int32)[:, None]], False, (200, 190, 170), 7, cv2.LINE_AA, 3
    )
    return image, xy


def labelled_project(root: Path) -> Project:
    """A project with ten labelled frames."""
    project = Project.create(root, keypoints=KEYPOINTS)
    lines = "".join(f"{key} = {value}\n" for key, value in TRAINING.items())
    settings = root / "bendtrack.toml"
    settings.write_text(settings.read_text().replace("[training]\n", f"[training]\n{lines}"))
    store, labels = LabelStore.of(project), {}
    for index, angle in enumerate(np.linspace(0, 100, 10)):
        image, xy = arm(angle)
        store.add_image("arm", image_name(index), image)
        labels[image_name(index)] = xy
    store.write("arm", labels)
    return Project.open(root)


class _StoppingReporter(SilentReporter):
    """Presses Ctrl-C after the second step of a training."""

    @contextmanager
    def training(self, title: str) -> Iterator[Callable[[Any], None]]:
        yield lambda progress: signal.raise_signal(signal.SIGINT) if progress.step == 2 else None


def stopped_training(root: Path) -> None:
    """A project whose training was interrupted after two steps."""
    project = labelled_project(root)
    settings = training.planned_settings(project, {})
    folder = model_folders.new_folder(project, None, False)
    with suppress(training.StoppedTraining):
        training.train_network(project, folder, settings, reporter=_StoppingReporter())
    assert (folder / STATE_FILE).is_file()


def rig(root: Path) -> None:
    """Angles and a pressure log of one trial."""
    for folder, header, rate, values in (
        ("angles", "time_s,angle_deg", 30, lambda phase: 100 * phase),
        ("logs", "Time (s),P [kPa]", 200, lambda phase: 40 * phase),
    ):
        time_s = np.arange(0, 12, 1 / rate)
        phase = 1 - np.abs(1 - 2 * (time_s / 4 % 1))
        (root / folder).mkdir(parents=True)
        np.savetxt(
            root / folder / "original_0.25Hz_40kPa.csv",
            np.column_stack([time_s, values(phase)]),
            fmt="%.5f",
            delimiter=",",
            header=header,
            comments="",
        )


def prepare(desk: Path, names: list[str]) -> None:
    """Make what the commands need."""
    needed = {need for name in names for need in COMMANDS[name].needs}
    desk.mkdir()
    if "film.mp4" in needed:
        with VideoWriter(desk / "film.mp4", SIZE_WH, 30.0) as writer:
            for index in range(12):
                writer.write(arm(50 - 50 * np.cos(index / 2))[0], index / 30)
    if "labelled" in needed:
        labelled_project(desk / "labelled")
    if "stopped" in needed:
        stopped_training(desk / "stopped")
    if needed & {"trained", "plain"}:
        labelled_project(desk / "plain")
        done(desk, "train plain")
        shutil.copytree(desk / "plain", desk / "trained")
        if "trained" in needed:
            done(desk, "track trained film.mp4" if "film.mp4" in needed else "evaluate trained")
            shutil.rmtree(desk / "trained" / "results", ignore_errors=True)
            (desk / "trained" / "results").mkdir()
    if "rig" in needed:
        rig(desk / "rig")
    if "rig2" in needed:
        rig(desk / "rig2")
        done(desk, "analyze --init rig2")


# --- running -----------------------------------------------------------------------------------------------


def started(
    folder: Path, arguments: str, *, file_size: int | None = None, prefix: str = ""
) -> subprocess.Popen[str]:
    """A command in a process of its own, in a folder; `prefix` is put in front of every path."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "XDG_CACHE_HOME": str(folder.parent / "cache")}

    def limit() -> None:
        if file_size is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_size, file_size))

    return subprocess.Popen(
        [BENDTRACK, *arguments.replace("{}", prefix).split()],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=limit,
        start_new_session=True,
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit status and what was said on stderr."""
    try:
        _, err = process.communicate(timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return -1, "did not end"
    return process.returncode, err


def done(folder: Path, arguments: str) -> float:
    """Run a command that must end well; how long it took, s."""
    begun = time.monotonic()
    status, err = ended(started(folder, arguments))
    if status != 0:
        raise SystemExit(f"{arguments}: expected status 0, got {status}: {err}")
    return time.monotonic() - begun


# --- judging -----------------------------------------------------------------------------------------------


def shown(folder: Path) -> dict[str, Path]:
    """Files under final names, by their path."""
    return {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }


def temporaries(folder: Path) -> list[str]:
    """What looks like a temporary file or folder."""
    return [p.relative_to(folder).as_posix() for p in folder.rglob("*") if TEMPORARY.search(p.name)]


def half_written(folder: Path) -> list[str]:
    """Files under final names that are not whole."""
    bad = []
    for name, path in shown(folder).items():
        try:
            content(path)
        except Exception as error:
            bad.append(f"{name} ({type(error).__name__}: {str(error)[:60]})")
    for record in folder.rglob("engine/engine.json"):
        checkpoint = record.parent.parent / "weights.safetensors"
        known = engine_record(checkpoint, file_sha256(checkpoint)) if checkpoint.is_file() else None
        if known is not None and not is_whole(checkpoint, known):
            bad.append(f"{record} names files that are not there")
    return bad


VOLATILE = re.compile(
    r"minutes|elapsed|seconds|_ms$|_at$|^date|created|sha256|hash|^files$|^path|^versions?$|^name$|uuid", re.I
)


def content(path: Path) -> Any:
    """What a file says, without times and without hashes of what holds times; an error where it is not whole."""
    match path.suffix:
        case ".json":
            return _steady(json.loads(path.read_text(encoding="utf-8")))
        case ".toml":
            text = path.read_text(encoding="utf-8")
            tomllib.loads(text)
            return re.sub(r"(?m)^created.*$", "", text)
        case ".csv":
            rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
            if not rows or not path.read_bytes().endswith(b"\n"):
                raise ValueError("cut")
            left = [i for i, title in enumerate(rows[0]) if not VOLATILE.search(title)]
            return [[row[i] for i in left if i < len(row)] for row in rows]
        case ".h5":
            found = {}
            with h5py.File(path) as file:
                file.visititems(
                    lambda name, item: (
                        found.update({name: np.asarray(item[()]).tolist().__repr__()})
                        if isinstance(item, h5py.Dataset) and name != "provenance"
                        else None
                    )
                )
            return found
        case ".safetensors":
            assert check_checksum(path)
            return {name: value.tobytes() for name, value in load_file(path).items()}
        case ".png":
            image = cv2.imread(str(path))
            assert image is not None
            return image.shape  # a figure may name a time
        case ".mp4":
            with av.open(str(path)) as film:
                return sum(1 for _ in film.decode(video=0))
        case _:
            assert path.stat().st_size > 0 or path.name == ".gitignore"
            return None


def _steady(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _steady(v) for k, v in value.items() if not VOLATILE.search(k)}
    return [_steady(v) for v in value] if isinstance(value, list) else value


def contents(folder: Path) -> dict[str, Any]:
    """All files under final names, as `content` sees them."""
    return {name: content(path) for name, path in shown(folder).items()}


def differences(found: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    """Names of files that are missing, new, or say something else."""
    return [
        name for name in sorted(found.keys() | expected.keys()) if found.get(name, 0) != expected.get(name, 0)
    ]


# --- trouble -----------------------------------------------------------------------------------------------


@dataclass
class Case:
    """One command with one trouble: counts, and what went wrong in words."""

    tried: int = 0
    untouched: int = 0
    """Trials in which the command had ended before the trouble came."""
    wrong: list[str] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        self.wrong = []


class Bench:
    """Runs one command with each trouble on copies of the desk."""

    def __init__(self, name: str, desk: Path, work: Path, rng: random.Random) -> None:
        self.command, self.desk, self.work, self.rng = COMMANDS[name], desk, work, rng
        folder = self.copy(work / "reference")
        self.seconds = done(folder, self.command.arguments)
        self.expected = contents(folder)
        self.written = sum(path.stat().st_size for path in shown(folder).values()) - self._needed()
        shutil.rmtree(folder)

    def _needed(self) -> int:
        return sum(path.stat().st_size for n in self.command.needs for path in _files(self.desk / n))

    def copy(self, folder: Path) -> Path:
        """A fresh copy of what the command needs."""
        folder.mkdir(parents=True, exist_ok=True)
        for need in self.command.needs:
            source = self.desk / need
            (shutil.copytree if source.is_dir() else shutil.copy2)(source, folder / need)
        return folder

    def differences(self, folder: Path) -> list[str]:
        """Names of files that are not as a run that nobody disturbed leaves them."""
        names = differences(contents(folder), self.expected)
        if self.command.adds:
            return [name for name in names if (self.desk / name).exists()]
        return names

    def one(self, trouble: str, case: Case) -> None:
        """One trial."""
        case.tried += 1
        folder = self.work / "trial"
        with self.place(folder, trouble):
            self.copy(folder)
            status, err = getattr(self, f"_{trouble.replace('-', '_')}")(folder, case)
            said = err.strip().splitlines()
            if "Traceback" in err or status == -1:
                case.wrong.append(f"traceback or no end: {said[-1] if said else ''}")
            elif status not in (0, -signal.SIGKILL) and not any(line.startswith("error:") for line in said):
                case.wrong.append(f"status {status} without a line: {said}")
            case.wrong += [f"half-written: {name}" for name in half_written(folder)]
            if trouble == "twice":
                return
            self.again(folder, case)

    def again(self, folder: Path, case: Case) -> None:
        """The command once more: it must end well, with what it would have written undisturbed."""
        for arguments in dict.fromkeys(
            (self.command.arguments, self.command.again or self.command.arguments)
        ):
            status, err = ended(started(folder, arguments))
            if status == 0:
                break
        left = temporaries(folder)
        # What is complete already may say so.
        complete = (
            "there already",
            "without study.toml",
            "expected an unfinished training",
            "expected a new",
        )
        if status != 0 and not any(words in err for words in complete):
            case.wrong.append(f"again: status {status}: {err.strip().splitlines()[-1:]}")
        unlike = self.differences(folder)
        if unlike:
            case.wrong.append(
                f"again, not as undisturbed: {unlike[:4]}" + (f" after: {err.strip()}" if status else "")
            )
        if left:
            case.wrong.append(f"left: {left[:3]}")

    @contextmanager
    def place(self, folder: Path, trouble: str) -> Iterator[None]:
        """An empty folder, a file system of its own where the trouble asks for one."""
        folder.mkdir()
        mounted = trouble in ("full", "read-only") and _mount(folder)
        try:
            yield
        finally:
            if mounted:
                subprocess.run(["umount", folder], check=True)
            shutil.rmtree(folder)

    def _killed(self, folder: Path, case: Case) -> tuple[int, str]:
        process = started(folder, self.command.arguments)
        # Half of the kills in the last third, where most is written.
        share = self.rng.choice((self.rng.random(), self.rng.uniform(0.65, 1.02)))
        with suppress(subprocess.TimeoutExpired):
            process.wait(share * self.seconds)
        case.untouched += process.poll() is not None
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        return ended(process)

    def _full(self, folder: Path, case: Case) -> tuple[int, str]:
        room = int(self.rng.random() * max(self.written, 4096))
        if os.path.ismount(folder):
            used = shutil.disk_usage(folder).used
            subprocess.run(["mount", "-o", f"remount,size={used + room}", folder], check=True)
            result = ended(started(folder, self.command.arguments))
            subprocess.run(["mount", "-o", "remount,size=1g", folder], check=True)
        else:
            result = ended(started(folder, self.command.arguments, file_size=room))
        case.untouched += result[0] == 0
        return result

    def _read_only(self, folder: Path, case: Case) -> tuple[int, str]:
        if not os.path.ismount(folder):
            case.untouched += 1
            return 0, ""
        subprocess.run(["mount", "-o", "remount,ro", folder], check=True)
        try:
            status, err = ended(started(folder, self.command.arguments))
        finally:
            subprocess.run(["mount", "-o", "remount,rw", folder], check=True)
        if status == 0:
            case.wrong.append("read-only: status 0")
        return status, err

    def _renamed(self, folder: Path, case: Case) -> tuple[int, str]:
        # By absolute paths, as relative ones follow a folder that is renamed.
        process = started(self.work, self.command.arguments, prefix=f"{folder}/")
        with suppress(subprocess.TimeoutExpired):
            process.wait(self.rng.uniform(0.3, 1.0) * self.seconds)
        case.untouched += process.poll() is not None
        away = folder.with_name("renamed")
        folder.rename(away)
        status, err = ended(process)
        if folder.exists():
            made = sorted(shown(folder))
            # A command that makes its folder may do so late, and then says that all is done.
            case.wrong += [f"made the folder anew, with {made[:3]}"] if made and status else []
            shutil.rmtree(folder)
        away.rename(folder)
        return status, err

    def _twice(self, folder: Path, case: Case) -> tuple[int, str]:
        processes = [started(folder, self.command.arguments) for _ in range(2)]
        results = [ended(process) for process in processes]
        if all(status != 0 for status, _ in results):
            case.wrong.append(f"both failed: {results[0][1].strip()}")
        left = temporaries(folder)
        if left:
            case.wrong.append(f"left: {left[:3]}")
        unlike = [name for name in self.differences(folder) if name in self.expected]
        if unlike:
            case.wrong.append(f"not as one alone: {unlike[:4]}")
        return max(results, key=lambda result: (("Traceback" in result[1]), result[0] != 0))


def killed_server(desk: Path, work: Path, rng: random.Random, case: Case) -> int:
    """Kill the labelling page's server between edits; how many edits it had acknowledged."""
    folder = work / "trial"
    folder.mkdir()
    shutil.copytree(desk / "labelled", folder / "labelled")
    acknowledged: dict[tuple[str, str], list[float]] = {}
    case.tried += 1
    try:
        process = started(folder, "label labelled --no-browser")
        page = Page(_address(process))
        frames = json.loads(page("GET", "/api/frames"))["frames"]
        revisions = {frame["id"]: frame["revision"] for frame in frames}
        end = time.monotonic() + rng.uniform(0.05, 2.0)
        killer = subprocess.Popen(
            ["sh", "-c", f"sleep {end - time.monotonic():.3f}; kill -KILL {process.pid}"],
            start_new_session=True,
        )
        count, pending = 0, None
        with suppress(OSError, ValueError, http_errors()):
            while True:
                frame, keypoint = rng.choice(frames), rng.choice(KEYPOINTS)
                xy = [rng.randrange(4 * SIZE_WH[0] - 8) / 4, rng.randrange(4 * SIZE_WH[1] - 8) / 4]
                pending = (frame["id"], keypoint, xy)
                answer = page(
                    "PUT",
                    frame["url"],
                    {
                        "edit_id": str(uuid.uuid4()),
                        "client_id": "kills",
                        "base_revision": revisions[frame["id"]],
                        "points": {keypoint: xy},
                    },
                )
                revisions[frame["id"]] = json.loads(answer)["revision"]
                acknowledged[frame["id"], keypoint] = xy
                count += 1
        killer.wait()
        process.communicate()
        page.connection.close()
        case.wrong += [f"half-written: {name}" for name in half_written(folder)]
        process = started(folder, "label labelled --no-browser")
        page = Page(_address(process))
        points = {
            frame["id"]: json.loads(page("GET", frame["url"]))["points"]
            for frame in json.loads(page("GET", "/api/frames"))["frames"]
        }
        page.connection.close()
        process.terminate()
        process.communicate()
        # The last edit may have been stored without an answer.
        lost = [
            key
            for key, xy in acknowledged.items()
            if (found := _point(points[key[0]], key[1])) != xy and (*key, found) != pending
        ]
        if lost:
            case.wrong.append(f"lost {len(lost)} acknowledged edits: {lost[:3]}")
        if left := temporaries(folder):
            case.wrong.append(f"left: {left[:3]}")
        return count
    finally:
        shutil.rmtree(folder)


def http_errors() -> type[Exception]:
    """What a connection raises whose server is gone."""
    import http.client

    return http.client.HTTPException


def _address(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().split()[-1]


def _point(points: Any, keypoint: str) -> Any:
    found = points[keypoint] if isinstance(points, dict) else None
    return found.get("xy", found) if isinstance(found, dict) else found


def _files(path: Path) -> list[Path]:
    return [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]


def _mount(folder: Path) -> bool:
    """A file system of its own at a folder; False where that is not allowed."""
    ran = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1g", "tmpfs", folder], capture_output=True, check=False
    )
    return ran.returncode == 0


def main() -> None:
    """Try and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=6, help="of each command with each trouble")
    parser.add_argument("--command", action="append", choices=list(COMMANDS))
    parser.add_argument("--trouble", action="append", choices=TROUBLES)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    names, troubles = args.command or list(COMMANDS), args.trouble or list(TROUBLES)
    rng = random.Random(args.seed)
    tried = wrong = 0
    with tempfile.TemporaryDirectory(prefix="bendtrack-kills-") as name:
        work = Path(name)
        prepare(work / "desk", names)
        print(f"{'command':12} {'trouble':10} {'tried':>6} {'too late':>9} {'wrong':>6}", flush=True)
        for command in names:
            if command == "label":
                case = Case()
                edits = sum(killed_server(work / "desk", work, rng, case) for _ in range(args.trials))
                print(
                    f"{command:12} {'killed':10} {case.tried:6} {0:9} {len(case.wrong):6}  {edits} edits",
                    flush=True,
                )
                print(*(f"    {line}" for line in case.wrong), sep="\n", end="\n" if case.wrong else "")
                tried, wrong = tried + case.tried, wrong + len(case.wrong)
                continue
            bench = Bench(command, work / "desk", work, rng)
            for trouble in troubles:
                case = Case()
                for _ in range(1 if trouble == "read-only" else args.trials):
                    try:
                        bench.one(trouble, case)
                    except (BendtrackError, AssertionError, KeyError, ValueError, OSError) as error:
                        case.wrong.append(f"{type(error).__name__}: {error}")
                        with contextlib.suppress(OSError):
                            shutil.rmtree(work / "trial")
                print(
                    f"{command:12} {trouble:10} {case.tried:6} {case.untouched:9} {len(case.wrong):6}",
                    flush=True,
                )
                for line in case.wrong:
                    print(f"    {line}", flush=True)
                tried, wrong = tried + case.tried, wrong + len(case.wrong)
    print(f"{tried} tried, {wrong} wrong")


if __name__ == "__main__":
    main()
