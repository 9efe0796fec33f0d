"""Imports that need care: late ones, missing extras, packages in the way."""
