"""Light: reflectance, sun visibility, shadows of rocks, indirect light, lamp."""
