"""The JSON Schema of configuration files."""

import json
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from workbench.config.configuration import VERSION, Config
from workbench.config.presets import PRESETS


class _SchemaOfFiles(GenerateJsonSchema):
    """Pydantic's schema without titles derived from keys, and without defaults, which come from a file's preset."""

    def field_title_should_be_set(self, schema) -> bool:
        return False

    def default_schema(self, schema) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def dict_schema(self, schema) -> dict[str, Any]:
        made = super().dict_schema(schema)
        return {**made, "additionalProperties": False} if "patternProperties" in made else made


def config_schema() -> str:
    """JSON Schema (draft 2020-12) of configuration files of the current version, as text.

    It covers keys, types, ranges and choices. Rules across several values are checked by `read_config`.
    """
    schema = Config.model_json_schema(schema_generator=_SchemaOfFiles)
    for name, field in Config.model_fields.items():
        section = field.annotation
        if isinstance(section, type) and issubclass(section, BaseModel):
            schema["properties"][name]["description"] = section.__doc__
    schema["properties"]["preset"]["enum"] = list(PRESETS)
    head = {
        "$schema": GenerateJsonSchema.schema_dialect,
        "$id": f"urn:face-energy-workbench:configuration:{VERSION}",
        "title": "Face Energy Workbench configuration",
        "description": "Settings of a run. Values missing from a file come from its preset.",
    }
    rest = {key: value for key, value in schema.items() if key not in head}
    return json.dumps({**head, **rest}, indent=2, ensure_ascii=False) + "\n"
