"""Makes a development certificate authority, and certificates of a host and its clients."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from iher_robot.config.yaml import format_yaml
from iher_robot.errors import UserError

CLIENTS = ("operator", "learner", "viewer", "perception")
"""Default names of clients, one for each role."""

HOST = "host"
_AUTHORITY = "authority"
_ALWAYS = ("localhost", "127.0.0.1", "::1")
_VALID = timedelta(days=365)
_BACKDATED = timedelta(hours=1)
"""Bears a difference between the clocks of two machines."""
_PORT = 7447
_NAME = re.compile(r"[a-z0-9][a-z0-9_.-]{0,63}")
_HOST_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")


@dataclass(frozen=True)
class CertifiedKey:
    """A certificate with its private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    def certificate_pem(self) -> bytes:
        """Return the certificate as PEM."""
        return self.certificate.public_bytes(Encoding.PEM)

    def key_pem(self) -> bytes:
        """Return the private key as PEM, without a password."""
        return self.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def make_certificates(
    folder: Path, hosts: Sequence[str] = (), names: Sequence[str] = CLIENTS
) -> tuple[Path, ...]:
    """Make an authority, and a folder with the files of the host and of each client.

    Args:
        folder: Gets the folders; created if it does not exist.
        hosts: Names and addresses of the host's machine, in addition to those of loopback.
        names: Names of clients. A client named as a role has that role; others are viewers.

    Returns:
        The files, in the order in which they are written.

    Raises:
        UserError: A name is not allowed, or a file exists; then nothing is written.
    """
    _check_names(hosts, names)
    authority = make_authority()
    reached = tuple(dict.fromkeys((*_ALWAYS, *hosts)))
    files = {
        f"{_AUTHORITY}/ca.pem": authority.certificate_pem(),
        f"{_AUTHORITY}/ca-key.pem": authority.key_pem(),
        **_client_files(HOST, authority, issue(authority, HOST, reached)),
        f"{HOST}/security.yaml": _security_yaml(names),
    }
    for name in dict.fromkeys(names):
        files |= _client_files(name, authority, issue(authority, name))
        files[f"{name}/robot.yaml"] = _robot_yaml(hosts[0] if hosts else _ALWAYS[0])
    return _write(folder, files)


def make_authority() -> CertifiedKey:
    """Make a certificate authority that is valid for one year."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _common_name("iher-robot development authority")
    certificate = (
        _builder(name, name, key)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    return CertifiedKey(certificate, key)


def issue(authority: CertifiedKey, name: str, hosts: Sequence[str] = ()) -> CertifiedKey:
    """Issue a certificate that is valid for one year.

    Args:
        authority: Signs it.
        name: Common name.
        hosts: Names and addresses of a host; none for a client.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    usage = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
    issuer = authority.certificate.subject
    certificate = (
        _builder(_common_name(name), issuer, key)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
        .add_extension(
            x509.SubjectAlternativeName([_general_name(host) for host in hosts or (name,)]),
            critical=False,
        )
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()),
            critical=False,
        )
        .sign(authority.key, hashes.SHA256())
    )
    return CertifiedKey(certificate, key)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BACKDATED)
        .not_valid_after(now + _VALID)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _key_usage(signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _client_files(name: str, authority: CertifiedKey, certified: CertifiedKey) -> dict[str, bytes]:
    return {
        f"{name}/ca.pem": authority.certificate_pem(),
        f"{name}/certificate.pem": certified.certificate_pem(),
        f"{name}/key.pem": certified.key_pem(),
    }


_TLS: Mapping[str, str] = {"ca": "ca.pem", "certificate": "certificate.pem", "key": "key.pem"}


def _security_yaml(names: Sequence[str]) -> bytes:
    roles: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        roles.setdefault(name if name in CLIENTS else "viewer", []).append(name)
    return format_yaml({"tls": dict(_TLS), "roles": roles}).encode()


def _robot_yaml(host: str) -> bytes:
    address = f"[{host}]" if ":" in host else host
    content = {"driver": "zenoh", "robot": "fetch", "connect": [f"tls/{address}:{_PORT}"]}
    return format_yaml(content | {"tls": dict(_TLS)}).encode()


def _check_names(hosts: Sequence[str], names: Sequence[str]) -> None:
    if not names:
        raise UserError(f"no client to make a certificate for; give names, such as {CLIENTS[0]}")
    for name in names:
        if not _NAME.fullmatch(name) or name in (HOST, _AUTHORITY):
            raise UserError(
                f"--name is {name!r}, allowed: up to 64 lowercase letters, digits, _ . and -, "
                f"starting with a letter or digit, but not {HOST} or {_AUTHORITY}"
            )
    for host in hosts:
        try:
            ip_address(host)
        except ValueError:
            if not _HOST_NAME.fullmatch(host):
                raise UserError(
                    f"--host is {host!r}, allowed: a machine's name or address, without a port"
                ) from None


def _write(folder: Path, files: Mapping[str, bytes]) -> tuple[Path, ...]:
    for name in files:
        if (path := folder / name).exists() or path.is_symlink():
            raise UserError(
                f"{path} exists and is not overwritten; name another folder, or remove the file"
            )
    try:
        for name, content in files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            mode = 0o600 if name.endswith("key.pem") else 0o644
            # With its mode from the start, so that no other user can read a key in between.
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
    except OSError as error:
        raise UserError(f"cannot write {error.filename}: {error.strerror}") from error
    return tuple(folder / name for name in files)
