"""A policy comes back exactly, or an error names its file; nothing in it is executed."""

from __future__ import annotations

import dataclasses
import io
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from iher_robot.errors import UserError
from iher_robot.evaluation.policy_file import (
    VERSION,
    PolicyFile,
    check_task,
    load_policy,
    save_policy,
)
from iher_robot.storage.files.checksum import add_zip_checksum


def make_policy() -> PolicyFile:
    generator = torch.Generator().manual_seed(0)
    return PolicyFile(
        task="push",
        layout={"gripper": [0, 3], "object": [3, 6]},
        layout_digest="ab" * 32,
        spec={"control_period": 0.04, "frames": ["world"]},
        interface_digest="cd" * 32,
        body_digest="ef" * 32,
        controller={"kind": "mocap"},
        policy={
            "hidden": [8],
            "source_input": True,
            "actor": {"0.weight": torch.randn(8, 3, generator=generator)},
            "obs_normalizer": {"mean": torch.zeros(3), "count": torch.tensor(7)},
        },
        trained={"algo": "iher", "seed": 3, "final_success": None},
    )


def assert_same(actual: Any, expected: Any) -> None:
    if isinstance(expected, torch.Tensor):
        assert actual.dtype == expected.dtype
        assert torch.equal(actual, expected)
    elif isinstance(expected, dict):
        assert list(actual) == list(expected)
        for name in expected:
            assert_same(actual[name], expected[name])
    else:
        assert type(actual) is type(expected)
        assert actual == expected


def fields(policy: PolicyFile) -> dict[str, Any]:
    return {field.name: getattr(policy, field.name) for field in dataclasses.fields(policy)}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "policy.pt"
    save_policy(path, make_policy())
    return path


def rewrite(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the content under a valid seal, as another program could."""
    content = torch.load(path, weights_only=True)
    change(content)
    buffer = io.BytesIO()
    torch.save(content, buffer)
    path.write_bytes(add_zip_checksum(buffer.getvalue()))


def test_a_policy_comes_back_exactly(path: Path) -> None:
    assert_same(fields(load_policy(path)), fields(make_policy()))


def test_torch_reads_the_file_with_weights_only(path: Path) -> None:
    content = torch.load(path, weights_only=True)
    assert (content["format"], content["version"], content["task"]) == (
        "iher-robot policy",
        VERSION,
        "push",
    )


def test_a_view_does_not_drag_its_storage_into_the_file(tmp_path: Path) -> None:
    big = torch.zeros(1_000_000)
    policy = dataclasses.replace(make_policy(), policy={"actor": big[:3]})
    save_policy(tmp_path / "policy.pt", policy)
    assert (tmp_path / "policy.pt").stat().st_size < 10_000


def test_a_mutated_file_is_an_error_that_names_it(path: Path) -> None:
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(1000):
        mutated = bytearray(content)
        kind = rng.integers(3)
        place = int(rng.integers(len(content)))
        if kind == 0:
            mutated[place] ^= int(rng.integers(1, 256))
        elif kind == 1:
            del mutated[place : place + int(rng.integers(1, 64))]
        else:
            mutated[place:place] = rng.bytes(int(rng.integers(1, 64)))
        path.write_bytes(mutated)
        with pytest.raises(UserError, match=r"policy\.pt"):
            load_policy(path)


def test_truncated_and_foreign_files_are_errors_that_name_them(path: Path) -> None:
    content = path.read_bytes()
    for foreign in (b"", b"x", content[:-1], content[: len(content) // 2], b"PK" * 500):
        path.write_bytes(foreign)
        with pytest.raises(UserError, match=r"policy\.pt is no policy file"):
            load_policy(path)


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no policy file at .*absent\.pt"):
        load_policy(tmp_path / "absent.pt")
    with pytest.raises(UserError, match="is a folder"):
        load_policy(tmp_path)


class Malicious:
    """Unpickling this would create a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.target,))


@pytest.mark.parametrize("sealed", [True, False])
@pytest.mark.parametrize("as_torch", [True, False])
def test_nothing_in_a_file_is_executed(tmp_path: Path, sealed: bool, as_torch: bool) -> None:
    target = tmp_path / "executed"
    buffer = io.BytesIO()
    if as_torch:
        torch.save({"format": "iher-robot policy", "policy": Malicious(target)}, buffer)
    else:
        # Protocol 2, which torch's old format is; its unpickler takes no trailing bytes amiss.
        pickle.dump(Malicious(target), buffer, protocol=2)
        buffer.write(b"\0\0")
    path = tmp_path / "policy.pt"
    path.write_bytes(add_zip_checksum(buffer.getvalue()) if sealed else buffer.getvalue())

    with pytest.raises(UserError, match=r"policy\.pt is no policy file"):
        load_policy(path)

    assert not target.exists()
    if as_torch:
        torch.load(path, weights_only=False)
        assert target.exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(format="other"), "no policy file"),
        (
            lambda c: c.update(version=VERSION + 1),
            rf"policy format {VERSION + 1}, this iher-robot reads up to {VERSION}",
        ),
        (lambda c: c.update(version="1"), "version is '1'"),
        (lambda c: c.update(version=0), "version is 0"),
        (lambda c: (c.pop("layout"), c.pop("trained")), "has no layout, trained"),
        (lambda c: c.update(task=3), "task is int, expected str"),
        (lambda c: c.update(policy=[1]), "policy is list, expected dict"),
        (
            lambda c: c["policy"]["actor"]["0.weight"].fill_(torch.nan),
            r"policy\.actor\.0\.weight is not finite",
        ),
        (
            lambda c: c["policy"]["obs_normalizer"].update(mean=torch.tensor([torch.inf])),
            r"policy\.obs_normalizer\.mean is not finite",
        ),
    ],
)
def test_bad_content_is_an_error_that_names_the_file(
    path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    rewrite(path, change)
    with pytest.raises(UserError, match=message) as error:
        load_policy(path)
    assert "policy.pt" in str(error.value)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (torch.tensor([1.0, torch.nan]), r"policy\.actor.* not finite"),
        (float("nan"), r"policy\.actor.* not finite"),
        (np.zeros(3), r"policy\.actor is ndarray"),
        (np.float64(3), r"policy\.actor is float64"),
        ({3: 4}, r"policy\.actor has keys"),
        ([Path("x")], r"policy\.actor\[0\] is PosixPath"),
    ],
)
def test_what_could_not_be_read_back_is_not_saved(path: Path, value: object, message: str) -> None:
    before = path.read_bytes()
    with pytest.raises(ValueError, match=message):
        save_policy(path, dataclasses.replace(make_policy(), policy={"actor": value}))
    assert path.read_bytes() == before


def test_a_policy_is_for_one_task_and_layout() -> None:
    policy = make_policy()
    check_task(policy, "push", policy.layout_digest)
    with pytest.raises(UserError, match="for task 'push', not 'slide'"):
        check_task(policy, "slide", policy.layout_digest)
    with pytest.raises(UserError, match="another observation layout"):
        check_task(policy, "push", "00" * 32)
