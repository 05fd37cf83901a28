"""The development certificate authority, and the files that it makes."""

from __future__ import annotations

import stat
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import pytest
import typer
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from typer.testing import CliRunner

from drivers.remote.link import link_options
from iher_robot.cli.certs import certs
from iher_robot.config.robot import choose_robot
from iher_robot.errors import UserError
from iher_robot.host.network.certificates import CLIENTS, issue, make_authority, make_certificates
from iher_robot.host.network.security import read_security


def _certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def _common_name(certificate: x509.Certificate) -> str | bytes:
    (attribute,) = certificate.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
    return attribute.value


def test_certificates_are_signed_by_the_authority_for_a_year(tmp_path: Path) -> None:
    make_certificates(tmp_path)
    authority = _certificate(tmp_path / "authority/ca.pem")
    for name in ("host", *CLIENTS):
        certificate = _certificate(tmp_path / name / "certificate.pem")
        certificate.verify_directly_issued_by(authority)
        key = load_pem_private_key((tmp_path / name / "key.pem").read_bytes(), None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        assert isinstance(key.curve, ec.SECP256R1)
        assert key.public_key() == certificate.public_key()
        assert _common_name(certificate) == name
        assert _certificate(tmp_path / name / "ca.pem") == authority
        left = certificate.not_valid_after_utc - datetime.now(UTC)
        assert timedelta(days=364) < left <= timedelta(days=365)


def test_certificates_of_another_authority_are_not_valid() -> None:
    certified = issue(make_authority(), "operator")
    with pytest.raises(InvalidSignature):
        certified.certificate.verify_directly_issued_by(make_authority().certificate)


def test_the_certificate_of_the_host_has_its_names(tmp_path: Path) -> None:
    make_certificates(tmp_path, hosts=["robot.local", "10.0.0.7"])
    names = _certificate(tmp_path / "host/certificate.pem").extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    assert set(names.value.get_values_for_type(x509.DNSName)) == {"localhost", "robot.local"}
    addresses = set(names.value.get_values_for_type(x509.IPAddress))
    assert addresses == {ip_address(each) for each in ("127.0.0.1", "::1", "10.0.0.7")}


def test_keys_are_readable_by_the_owner_only(tmp_path: Path) -> None:
    keys = [path for path in make_certificates(tmp_path) if path.name.endswith("key.pem")]
    assert len(keys) == 2 + len(CLIENTS)
    assert {stat.S_IMODE(path.stat().st_mode) for path in keys} == {0o600}


def test_the_written_files_can_be_read(tmp_path: Path) -> None:
    make_certificates(tmp_path, hosts=["fd00::7"], names=("operator", "anna"))
    security = read_security(tmp_path / "host/security.yaml")
    assert security is not None
    assert security.roles.names() == {"operator": ("operator",), "viewer": ("anna",)}
    robot = choose_robot(None, str(tmp_path / "anna/robot.yaml"))
    options = link_options(robot.options)
    assert robot.driver == "zenoh"
    assert options.connect == ("tls/[fd00::7]:7447",)
    assert options.tls is not None
    assert options.tls.key == tmp_path / "anna/key.pem"


def test_nothing_is_overwritten_or_left_incomplete(tmp_path: Path) -> None:
    (tmp_path / "viewer").mkdir()
    (tmp_path / "viewer/key.pem").write_text("mine")
    with pytest.raises(UserError, match=r"viewer/key\.pem exists and is not overwritten"):
        make_certificates(tmp_path)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["key.pem"]
    assert (tmp_path / "viewer/key.pem").read_text() == "mine"


@pytest.mark.parametrize("name", ["", "../up", "Anna", "host", "authority", "a b", "x" * 65])
def test_a_name_is_no_path(tmp_path: Path, name: str) -> None:
    with pytest.raises(UserError, match="--name is"):
        make_certificates(tmp_path, names=["viewer", name])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("host", ["", "tls/a", "a:7447", "a b", "-a"])
def test_a_host_is_a_name_or_an_address(tmp_path: Path, host: str) -> None:
    with pytest.raises(UserError, match="--host is"):
        make_certificates(tmp_path, hosts=[host])


def test_the_command_prints_the_files(tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(certs)
    arguments = [str(tmp_path / "made"), "--name", "viewer", "--host", "10.0.0.7"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0
    made = {str(path) for path in (tmp_path / "made").rglob("*") if path.is_file()}
    assert made == {line for line in result.output.splitlines() if line in made}
    assert len(made) == 2 + 4 + 4
    assert "development" in result.output
