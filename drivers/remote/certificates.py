"""Checks of the certificates of a link with mutual TLS."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from pydantic import BaseModel, ConfigDict

from drivers.errors import InvalidSpec

_HINT = "make new ones with: iher-robot certs DIR"


class TlsFiles(BaseModel):
    """Certificates for mutual TLS, PEM files."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    ca: Path
    """Certificate of the authority that both sides trust."""
    certificate: Path
    """Certificate of this side."""
    key: Path
    """Its private key."""


def check_certificates(files: TlsFiles) -> None:
    """Check certificates before Zenoh uses them: Zenoh gives no reason when it cannot connect.

    Args:
        files: Files of one side of a link.

    Raises:
        InvalidSpec: A file is missing or not PEM, a certificate has expired or is not yet valid,
            or the key belongs to another certificate.
    """
    _certificate("tls.ca", files.ca)
    certificate = _certificate("tls.certificate", files.certificate)
    content = _read("tls.key", files.key)
    try:
        key = load_pem_private_key(content, password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise InvalidSpec(
            f"tls.key {str(files.key)!r} holds no PEM private key without a password; {_HINT}"
        ) from None
    if key.public_key() != certificate.public_key():
        raise InvalidSpec(
            f"tls.key {str(files.key)!r} is not the key of tls.certificate "
            f"{str(files.certificate)!r}; give a certificate and a key that belong together"
        )


def _certificate(name: str, path: Path) -> x509.Certificate:
    content = _read(name, path)
    try:
        certificate = x509.load_pem_x509_certificate(content)
    except ValueError:
        raise InvalidSpec(f"{name} {str(path)!r} holds no PEM certificate; {_HINT}") from None
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    now = datetime.now(UTC)
    if not begin <= now <= end:
        raise InvalidSpec(
            f"{name} {str(path)!r} is valid from {begin:%Y-%m-%d} to {end:%Y-%m-%d}, today is "
            f"{now:%Y-%m-%d}; set the clock, or {_HINT}"
        )
    return certificate


def _read(name: str, path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidSpec(f"{name} {str(path)!r} cannot be read: {error.strerror}") from None
