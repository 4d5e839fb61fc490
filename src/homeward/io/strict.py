"""The base of all settings models."""

from pydantic import BaseModel, ConfigDict


class Strict(BaseModel):
    """A settings model that refuses unknown keys and cannot be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)
