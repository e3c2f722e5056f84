"""Process with some files of this machine replaced, in a private mount namespace."""

from __future__ import annotations

import os
import subprocess

import pytest


@pytest.fixture(scope="session")
def namespace() -> list[str]:
    """Words before a command that may mount file systems; skipped if this is not permitted."""
    # Root makes one as it is; others are made root of a namespace of users too.
    user = [] if os.geteuid() == 0 else ["--user", "-r"]
    command = ["unshare", *user, "--mount"]
    tried = subprocess.run([*command, "mount", "--bind", "/mnt", "/mnt"], capture_output=True)
    if tried.returncode:
        pytest.skip("this machine lets nobody make namespaces")
    return command
