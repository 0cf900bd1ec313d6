"""A certificate of this machine's own, for https where nobody provides one."""

from __future__ import annotations

import socket
import subprocess
from pathlib import Path

from common.errors import DeviceError

DAYS = 3650
OPENSSL_S = 60.0


def own_certificate(folder: Path) -> tuple[str, str]:
    """Returns the files of certificate and key (PEM) in `folder`, which openssl makes when either is missing.

    Raises DeviceError if it cannot.
    """
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    if not (certificate.is_file() and key.is_file()):
        names = f"subjectAltName=DNS:localhost,IP:127.0.0.1,DNS:{socket.gethostname()}"
        command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
        command += ["-days", str(DAYS), "-subj", "/CN=Leap Rig", "-addext", names, "-keyout", str(key)]
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            subprocess.run([*command, "-out", str(certificate)], check=True, capture_output=True, timeout=OPENSSL_S)
        except (OSError, subprocess.SubprocessError) as error:
            detail = getattr(error, "stderr", b"") or str(error).encode()
            reason = detail.decode(errors="replace").strip().splitlines()[-1]
            raise DeviceError(f"openssl made no certificate in {folder}: {reason}. The page needs one.") from error
    return str(certificate), str(key)
