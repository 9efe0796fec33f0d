from stair_env.common.markdown import format_value, markdown_table


def test_rows_with_different_columns_line_up() -> None:
    lines = markdown_table([{"a": 1}, {"b": 2.0}]).splitlines()
    assert lines == ["| a | b |", "|---|---|", "| 1 |  |", "|  | 2 |"]


def test_cells_cannot_break_the_table() -> None:
    assert format_value("a|b") == "a\\|b" and format_value({"w": 1.23456}) == "w 1.235"
