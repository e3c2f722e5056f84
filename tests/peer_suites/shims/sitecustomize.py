"""yaml.load as it was when upstream's API checker was written: PyYAML 6 wants a loader named."""

import yaml

_load = yaml.load


def _with_default(stream: object, Loader: type = yaml.SafeLoader) -> object:  # noqa: N803
    return _load(stream, Loader)


yaml.load = _with_default
