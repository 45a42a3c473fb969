"""Numbers that nobody can mean are refused in every setting."""

import pytest
from pydantic import ValidationError

from maslam.backend.config import CentralConfig, RobustConfig, SolverConfig
from maslam.descriptors.config import NetVladConfig, ProjectionConfig, TrainingConfig
from maslam.frontend.config import OdometryConfig
from maslam.frontend.recording_config import RecordingConfig
from maslam.mas.config import MasConfig
from maslam.mas.policies.presets import PRESETS, preset
from maslam.tools import cli
from maslam.tools.common.options import leaves
from maslam.tools.worlds.config import RenderConfig

MODELS = [OdometryConfig, MasConfig, SolverConfig, CentralConfig, RobustConfig, RenderConfig]
MODELS += [NetVladConfig, ProjectionConfig, TrainingConfig]


def of_floats():
    for model in MODELS:
        for path, field in leaves(model):
            if "float" in str(field.annotation):
                yield pytest.param(model, path, field, id=f"{model.__name__}.{path}")


def made(model, path, value):
    content = value
    for name in reversed(path.split(".")):
        content = {name: content}
    return model.model_validate(content)


@pytest.mark.parametrize(("model", "path", "field"), list(of_floats()))
def test_every_number_is_finite_and_of_some_size(model, path, field):
    tuples = "tuple" in str(field.annotation)
    for value in (float("inf"), float("-inf"), float("nan")):
        with pytest.raises(ValidationError):
            made(model, path, [value] * 3 if tuples else value)
    if (
        not tuples
        and not path.endswith(("_threshold", "tolerance"))
        and (not isinstance(field.default, float) or field.default == 0 or field.default > 1e-5)
    ):
        for value in (1e-12, 1e30):
            with pytest.raises(ValidationError):
                made(model, path, value)


def test_our_own_settings_are_within_reason():
    for name in PRESETS:
        MasConfig.model_validate(preset(name).model_dump())
    for model in MODELS:
        model.model_validate(model().model_dump())
    SolverConfig(pose_threshold=1e-12)  # where an iteration ends


@pytest.mark.parametrize("value", ["inf", "nan", "1e-12", "-inf"])
def test_the_command_says_so_in_one_line(tmp_path, capsys, value):
    words = ["slam", str(tmp_path), str(tmp_path / "out"), "--relpose.inlier-angle-deg", value]
    assert cli.main(words) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith(f"maslam: --relpose.inlier-angle-deg {value}: ") or "inlier-angle-deg" in lines[-1]
    config = tmp_path / "config.yaml"
    config.write_text(f"relpose:\n  inlier_angle_deg: {value.replace('inf', '.inf').replace('nan', '.nan')}\n")
    assert cli.main(["slam", str(tmp_path), str(tmp_path / "out"), "--config", str(config)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"maslam: {config}:2: ") and "unexpected" not in line


def test_yes_is_no_number():
    """YAML reads yes, no, on and off as true and false, which pydantic takes for 1 and 0."""
    for model, path in ((RecordingConfig, "stride"), (RecordingConfig, "end_s"), (CentralConfig, "iterations")):
        for value in (True, False):
            with pytest.raises(ValidationError, match="A number is meant, not true or false"):
                made(model, path, value)
    assert made(RecordingConfig, "stride", "2").stride == 2
