"""Writes the JSON Schemas of the project's TOML files beside itself: ``python docs/schemas/write.py``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from cosim.design.documents import FitData, MapData, SweepData, TuningData
from cosim.design.names import AxisNames, NctfNames
from cosim.study.claims import ClaimsData
from cosim.system.schema import SystemData

MODELS: Mapping[str, type[BaseModel]] = {
    "system": SystemData,
    "sweep": SweepData,
    "tuning": TuningData,
    "map": MapData,
    "fit": FitData,
    "claims": ClaimsData,
    "nctf_names": NctfNames,
    "friction_pulse_names": AxisNames,
}


class Schema(GenerateJsonSchema):
    """JSON Schemas whose tables have no other names than those that the reader takes."""

    def dict_schema(self, schema: core_schema.DictSchema) -> JsonSchemaValue:
        """A table with names that follow a pattern has no other names."""
        found = super().dict_schema(schema)
        return {**found, "additionalProperties": False} if "patternProperties" in found else found


def schema(name: str) -> str:
    """The text of a schema file."""
    content = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **MODELS[name].model_json_schema(schema_generator=Schema),
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for name in MODELS:
        Path(__file__).with_name(f"{name}.json").write_text(schema(name), encoding="utf-8")
