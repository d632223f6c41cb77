"""Frozen results: what short fits, verbs and exporters gave, compared with what they give now."""
