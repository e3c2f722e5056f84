"""Restore the old signature of yaml.load for upstream's API checker; PyYAML 6 requires a loader."""

import yaml

_load = yaml.load


def _with_default(stream: object, Loader: type = yaml.SafeLoader) -> object:  # noqa: N803
    return _load(stream, Loader)


yaml.load = _with_default
