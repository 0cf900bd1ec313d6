"""A certificate of this machine's own, which others know by its fingerprint."""

from __future__ import annotations

import hashlib
import socket
import ssl
import subprocess
from pathlib import Path
from typing import NamedTuple


class CertificateError(Exception):
    """There is no certificate; the text is one sentence for the user."""


class Certificate(NamedTuple):
    """The files of a certificate and its key (PEM)."""

    certificate: str
    key: str

    def server(self) -> ssl.SSLContext:
        """Returns the settings of a server; raises CertificateError for files that hold no such pair."""
        tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        tls.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            tls.load_cert_chain(self.certificate, self.key)
        except OSError as error:  # and ssl.SSLError
            raise CertificateError(f"{self.certificate} and {self.key} are no certificate and key: {error}.") from error
        return tls

    def fingerprint(self) -> str:
        """Returns its fingerprint; raises CertificateError for a file that holds no certificate."""
        try:
            text = Path(self.certificate).read_text(encoding="ascii")
            start = text.index(ssl.PEM_HEADER)
            end = text.index(ssl.PEM_FOOTER, start) + len(ssl.PEM_FOOTER)
            return fingerprint_of(ssl.PEM_cert_to_DER_cert(text[start:end]))
        except (OSError, ValueError) as error:
            raise CertificateError(f"{self.certificate} holds no certificate: {error}.") from error


def fingerprint_of(der: bytes) -> str:
    """Returns the SHA-256 of a certificate (DER), as 64 hexadecimal digits."""
    return hashlib.sha256(der).hexdigest()


def own_certificate(folder: Path) -> Certificate:
    """Returns certificate and key in `folder`, which openssl makes when either is missing. Raises CertificateError
    if it cannot."""
    days = 3650
    openssl_s = 60.0
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    if not (certificate.is_file() and key.is_file()):
        names = f"subjectAltName=DNS:localhost,IP:127.0.0.1,DNS:{socket.gethostname()}"
        command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
        command += ["-days", str(days), "-subj", "/CN=Leap Rig", "-addext", names, "-keyout", str(key)]
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            subprocess.run([*command, "-out", str(certificate)], check=True, capture_output=True, timeout=openssl_s)
        except (OSError, subprocess.SubprocessError) as error:
            detail = getattr(error, "stderr", b"") or str(error).encode()
            reason = detail.decode(errors="replace").strip().splitlines()[-1]
            raise CertificateError(f"openssl made no certificate in {folder}: {reason}. One is needed.") from error
    return Certificate(str(certificate), str(key))
