"""`stair-env bench`: ratios of time and memory, each pair measured in one run."""

from stair_env_cli.bench.command import add_parser, run

__all__ = ["add_parser", "run"]
