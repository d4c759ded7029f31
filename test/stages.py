"""Stages in tests: OpenUSD's own validators."""

from pathlib import Path

from pxr import Usd, UsdValidation


def problems(stage: Usd.Stage | Path) -> list[str]:
    """Return what OpenUSD's validators find wrong with a stage."""
    if isinstance(stage, Path):
        stage = Usd.Stage.Open(str(stage))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) >= 25
    return [f'{error.GetName()}: {error.GetMessage()}'
            for error in UsdValidation.ValidationContext(validators).Validate(stage)]
