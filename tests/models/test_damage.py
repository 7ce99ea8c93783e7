"""A file that computes is what was written, or it is not used: compiled networks, checkpoints, training states."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from bendtrack.models.detector import NetworkDetector
from bendtrack.models.inference.checksum import DamagedFileError, check_checksum
from bendtrack.models.inference.metadata import trained_at
from bendtrack.models.inference.runtime import RECORD, EngineError, compiled_estimator, engine_record
from bendtrack.models.networks.checkpoint import load_checkpoint
from bendtrack.models.networks.shipped import WEIGHTS, working_copy
from bendtrack.models.networks.tensor_files import read_tensors, write_tensors
from bendtrack.networks import load_network
from bendtrack.tracker.errors import BendtrackWarning, CheckpointError
from bendtrack.tracker.hashing import file_sha256
from bendtrack.tracker.project import Project


def flip_bits(path: Path, count: int = 100) -> None:
    """Change bits in the middle half of a file, whose size stays."""
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(1)
    for place in rng.integers(len(data) // 4, 3 * len(data) // 4, count):
        data[place] ^= 1 << int(rng.integers(8))
    path.write_bytes(data)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def folder_in_its_place(path: Path) -> None:
    path.unlink()
    path.mkdir()


def link_in_its_place(path: Path) -> None:
    """A link to a file that must not be written."""
    other = path.with_name("of-somebody-else")
    path.rename(other)
    path.symlink_to(other)
    other.write_bytes(b"precious")


DAMAGE: dict[str, Callable[[Path], object]] = {
    "flipped": flip_bits,
    "cut": cut,
    "empty": lambda path: path.write_bytes(b""),
    "missing": Path.unlink,
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"\0"),
    "text": lambda path: path.write_text("hello"),
    "folder": folder_in_its_place,
    "link": link_in_its_place,
}


@pytest.fixture(scope="module")
def network(trained_once: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a compiled network, outside a project, so that compiling it again takes a second."""
    folder = tmp_path_factory.mktemp("network") / "model"
    shutil.copytree(trained_once / "models" / "model", folder)
    return folder


@pytest.fixture
def damaged(network: Path, tmp_path: Path) -> Path:
    """A copy to be damaged."""
    return shutil.copytree(network, tmp_path / "model")


# --- compiled networks -----------------------------------------------------------------------------------


def used_files(folder: Path) -> list[Path]:
    """Files of the engine that would be taken."""
    engine = NetworkDetector.load(folder, device="cpu").engine
    return sorted((folder / "engine").glob(f"*-{engine}.*"))


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_engine_computes_nothing(damaged: Path, damage: str) -> None:
    record = engine_record(damaged / "weights.safetensors", file_sha256(damaged / "weights.safetensors"))
    for file in (damaged / "engine" / name for name in ("locator-openvino.xml", "locator-openvino.bin")):
        kept = file.read_bytes()
        DAMAGE[damage](file)
        with pytest.raises(EngineError, match=r"expected (the|a) compiled network") as caught:
            compiled_estimator(damaged / "weights.safetensors", "openvino", record)
        assert "\n" not in str(caught.value)
        if file.is_dir():
            file.rmdir()
        file.unlink(missing_ok=True)
        file.write_bytes(kept)


def test_two_parts_swapped_or_of_another_network_are_no_engine(damaged: Path) -> None:
    files = used_files(damaged)
    locator, refiner = ([f for f in files if f.name.startswith(part)] for part in ("locator", "refiner"))
    before = {file: file.read_bytes() for file in files}
    for one, other in zip(locator, refiner, strict=True):
        one.write_bytes(before[other])
        other.write_bytes(before[one])
    with pytest.raises(EngineError):
        NetworkDetector.load(damaged, engine=files[0].stem.partition("-")[2], device="cpu")


def test_without_compiling_again_torch_takes_the_place_of_a_damaged_engine(damaged: Path) -> None:
    flip_bits(used_files(damaged)[0])
    with pytest.warns(BendtrackWarning, match="torch computes, which is slower"):
        detector = NetworkDetector.load(damaged, device="cpu")
    assert detector.engine == "torch"


@pytest.mark.parametrize("damage", ["flipped", "folder", "link"])
def test_a_damaged_engine_is_compiled_again(damaged: Path, damage: str) -> None:
    images = np.random.default_rng(0).integers(0, 255, (2, 72, 96, 3), dtype=np.uint8)
    before = load_network(damaged, "openvino", "cpu").detect(images)
    file = damaged / "engine" / "refiner-openvino.bin"
    DAMAGE[damage](file)
    with pytest.warns(BendtrackWarning) as said:
        after = load_network(damaged, "openvino", "cpu").detect(images)
    assert "refiner-openvino.bin: expected" in str(said[0].message)
    np.testing.assert_array_equal(after.xy, before.xy)
    assert file.is_file()
    if damage == "link":
        assert (damaged / "engine" / "of-somebody-else").read_bytes() == b"precious"
    load_network(damaged, "openvino", "cpu")  # and says nothing more


def test_a_record_that_was_changed_is_refused(damaged: Path) -> None:
    file = damaged / "engine" / RECORD
    values = json.loads(file.read_text())
    # Refused for its quantisation error, and now said to have passed and to be the fastest.
    values["engines"]["openvino-int8"] |= {"passed": True, "cpu_ms": 0.001}
    file.write_text(json.dumps(values))
    assert NetworkDetector.load(damaged, device="cpu").engine == "torch"


def test_a_network_put_in_place_of_another_is_compiled_itself(damaged: Path) -> None:
    checkpoint = load_checkpoint(damaged)
    with torch.no_grad():
        checkpoint.network.refiner.head.bias += 0.5
    checkpoint.save(damaged)
    with pytest.raises(EngineError, match="expected a network compiled for this machine, got none"):
        NetworkDetector.load(damaged, device="cpu", require_compiled=True)


# --- checkpoints -----------------------------------------------------------------------------------------


def test_every_changed_bit_of_a_checkpoint_is_noticed(damaged: Path) -> None:
    file = damaged / "weights.safetensors"
    assert check_checksum(file)
    good = file.read_bytes()
    header = 8 + int.from_bytes(good[:8], "little")
    rng = np.random.default_rng(0)
    places = [0, 9, 30, 40, 60, header - 1, header, len(good) - 1, *rng.integers(0, header, 40).tolist()]
    for place in [*places, *rng.integers(header, len(good), 5).tolist()]:
        with file.open("r+b") as opened:
            opened.seek(place)
            opened.write(bytes([good[place] ^ 1 << int(rng.integers(8))]))
        with pytest.raises(CheckpointError) as caught:
            load_checkpoint(file)
        with file.open("r+b") as opened:
            opened.seek(place)
            opened.write(good[place : place + 1])
        assert str(file) in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("damage", ["flipped", "cut", "empty", "longer", "text"])
def test_a_damaged_checkpoint_is_one_line(
    bendtrack, trained_project: Project, film: Path, damage: str
) -> None:
    file = trained_project.models_dir / "model" / "weights.safetensors"
    DAMAGE[damage](file)
    for engine in ("auto", "torch"):
        ran = bendtrack("track", trained_project.root, film, "--engine", engine)
        assert ran.status == 2
        assert ran.err.startswith(f"error: {file}: expected ")
        assert ran.err.count("\n") == 1
        assert not list(trained_project.results_dir.iterdir())
    ran = bendtrack("evaluate", trained_project.root)
    assert (ran.status, ran.err.count("\n")) == (2, 1)
    ran = bendtrack("train", trained_project.root, "--init", file, "--name", "next")
    assert (ran.status, ran.err.count("\n")) == (2, 1)
    assert not (trained_project.models_dir / "next").exists()


@pytest.fixture
def film(tmp_path: Path, write_arm_video) -> Path:
    return write_arm_video(tmp_path / "film.mp4", 4)


def without_checksum(file: Path) -> None:
    """Make a checkpoint what an earlier version wrote."""
    header = json.loads((file.parent / "checkpoint.json").read_text())
    header["training"].pop("trained_at", None)
    save_file(load_file(file), file, metadata={"bendtrack": json.dumps(header)})


def test_a_checkpoint_from_before_the_checksum_goes_on_loading(damaged: Path) -> None:
    file = damaged / "weights.safetensors"
    images = np.zeros((1, 72, 96, 3), np.uint8)
    before = load_checkpoint(file).detect(images)
    without_checksum(file)
    assert not check_checksum(file)
    assert trained_at(file) is None
    np.testing.assert_array_equal(load_checkpoint(file).detect(images).xy, before.xy)


def test_an_older_checkpoint_that_changed_since_it_was_compiled_is_warned_of(damaged: Path) -> None:
    without_checksum(damaged / "weights.safetensors")  # another file than the one that was compiled
    with pytest.warns(BendtrackWarning, match="not the file that was compiled before"):
        load_network(damaged, "openvino", "cpu")


def test_the_shipped_networks_have_their_checksum_beside_them(tmp_path: Path) -> None:
    for file in sorted(WEIGHTS.glob("*/weights.safetensors")):
        assert check_checksum(file)
    copy = Path(shutil.copytree(file.parent, tmp_path / "copy")) / file.name
    flip_bits(copy, 1)
    with pytest.raises(
        DamagedFileError, match=r"expected the SHA-256 in weights.safetensors.sha256, got another"
    ):
        load_checkpoint(copy)


def test_a_damaged_working_copy_of_a_shipped_network_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    file = working_copy("resnet18") / "weights.safetensors"
    good = file.read_bytes()
    flip_bits(file)
    assert working_copy("resnet18") == file.parent
    assert file.read_bytes() == good


def test_tensors_are_read_as_they_were_written(tmp_path: Path) -> None:
    tensors = {"a": torch.arange(6.0).reshape(2, 3), "sha256": torch.zeros(64, dtype=torch.uint8)}
    # Zeros and words that look like the place of the checksum are no trouble.
    header = {"format": 1, "note": "0" * 64, "of": {"sha256": "0" * 64}}
    write_tensors(tmp_path / "t.safetensors", tensors, header)
    read = read_tensors(tmp_path / "t.safetensors")
    assert read.keys() == tensors.keys()
    assert all(torch.equal(read[name], value) for name, value in tensors.items())
    flip_bits(tmp_path / "t.safetensors", 1)
    with pytest.raises(DamagedFileError):
        read_tensors(tmp_path / "t.safetensors")
