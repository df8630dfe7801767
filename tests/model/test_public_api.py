"""The public API: every name is there, loads late, and is documented with its types."""

import inspect
import subprocess
import sys

import pytest

import model


@pytest.mark.parametrize("name", model.__all__)
def test_every_public_name_is_documented_and_typed(name: str) -> None:
    value = getattr(model, name)
    assert inspect.getdoc(value)
    if inspect.isfunction(value):
        signature = inspect.signature(value)
        assert signature.return_annotation is not inspect.Signature.empty
        assert all(p.annotation is not p.empty for p in signature.parameters.values())


def test_importing_the_api_loads_nothing_heavy() -> None:
    code = (
        "import sys, model\n"
        "heavy = {'torch', 'viser', 'open3d', 'trimesh', 'scipy', 'numpy'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = model.no_such_name
