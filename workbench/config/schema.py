"""The JSON Schema of configuration files."""

import json
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from workbench.config.configuration import VERSION, Config
from workbench.config.presets import PRESETS


class _SchemaOfFiles(GenerateJsonSchema):
    """As pydantic makes it, without titles made of keys and without defaults: those come from a file's preset."""

    def field_title_should_be_set(self, schema) -> bool:
        return False

    def default_schema(self, schema) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def dict_schema(self, schema) -> dict[str, Any]:
        made = super().dict_schema(schema)
        return {**made, "additionalProperties": False} if "patternProperties" in made else made


def config_schema() -> str:
    """JSON Schema (draft 2020-12) of configuration files of the present version, as text.

    It knows keys, types, ranges and choices. Rules that join several values are left to `read_config`.
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
        "description": "What a run does. What a file leaves out comes from its preset.",
    }
    rest = {key: value for key, value in schema.items() if key not in head}
    return json.dumps({**head, **rest}, indent=2, ensure_ascii=False) + "\n"
