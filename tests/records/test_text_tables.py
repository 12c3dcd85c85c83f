from twc_env.records.text_tables import aligned_text, csv_text, flat, latex_table, latex_text

ROWS = [["team", "score", "path m", "a long column"], ["voronoi", "0.91", "120", "1"], ["random", "0.5", "7", "2"]]


def test_wide_tables_fold_to_the_width_and_repeat_their_first_column():
    whole = aligned_text(ROWS)
    assert whole.count("\n") == 2 and "\n\n" not in whole
    for width in (20, 25, 30):
        folded = aligned_text(ROWS, width)
        assert max(map(len, folded.splitlines())) <= max(width, len("voronoi") + 2 + len("a long column"))
        blocks = folded.split("\n\n")
        assert len(blocks) > 1 and all(block.startswith("team") for block in blocks)
        assert sorted(folded.split())[-1] == sorted(whole.split())[-1]
        assert {word for row in ROWS for cell in row for word in cell.split()} <= set(folded.split())
    assert aligned_text(ROWS, 200) == whole


def test_columns_are_aligned():
    head, first, second = aligned_text(ROWS).splitlines()
    assert head.index("score") + len("score") == first.index("0.91") + 4 == second.index("0.5") + 3


def test_csv_has_every_key_and_leaves_empty_what_does_not_exist():
    assert csv_text([{"a": 1, "b": None}, {"a": float("nan"), "c": "x, y"}]) == 'a,b,c\n1,,\n,,"x, y"\n'
    assert flat({"a": {"b": {"c": 1}}, "d": [1, 2]}) == {"a.b.c": 1, "d": "1; 2"}


def test_latex_escapes_what_has_a_meaning_there():
    assert latex_text("50 % of A_1 & B\\") == r"50 \% of A\_1 \& B\textbackslash{}"
    assert latex_text("-0.27 (-0.5 to +0.1) +- 0.2") == r"$-$0.27 ($-$0.5 to +0.1) $\pm$ 0.2"
    assert latex_text("lds-01, gen:office:300:-3, 0-9, a-.py, -") == "lds-01, gen:office:300:-3, 0-9, a-.py, -"
    table = latex_table(ROWS)
    assert r"\begin{tabular}{lrrr}" in table and table.count(r"\\") == 3 and table.count("midrule") == 1
