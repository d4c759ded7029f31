"""What light does: reflectance, sun visibility, shadows of rocks, indirect light, lamp."""
