"""CSV in the dialects that people send, and Parquet: by pandas, polars, DuckDB, R, Octave, SQLite, asammdf, pyarrow and fastparquet."""

from __future__ import annotations

import csv
import sqlite3
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np

from foreign_logs.known import FORMULAS, ROWS, SINGLE, STATUS, Foreign, Known, RATE_Hz, START_s, TIME_s, as_put_in, signal

COLUMNS = {"time [s]": TIME_s} | {f"{name} [{'A' if 'current' in name else 'rad'}]": signal(name) for name in FORMULAS}
PLAIN = {name.partition(" ")[0]: values for name, values in COLUMNS.items()}
SHORT = {"t": TIME_s, "q": signal("position_roll"), "i": signal("current_roll")}
MAPS = ("t=time [s]", "q=position_roll [rad]", "i=current_roll [A]")
MAPPED = ("position_roll", "current_roll")


def panda(columns: dict[str, np.ndarray] = COLUMNS, path: str = "log.csv", before: str = "", **options: object) -> Callable[[Path], Path]:
    """Return a maker with pandas.DataFrame.to_csv; `before` goes into the file first."""

    def make(folder: Path) -> Path:
        import pandas

        file = folder / path
        with file.open("w", newline="", encoding=str(options.get("encoding", "utf-8"))) as stream:
            stream.write(before)
            pandas.DataFrame(columns).to_csv(stream, **{"index": False, "lineterminator": "\n"} | options)
        return file

    return make


def units_row(folder: Path) -> Path:
    """A row of units under the names, as measuring tools write it."""
    import pandas

    frame = pandas.DataFrame(PLAIN)
    units = pandas.DataFrame([{"time": "s", "position_roll": "deg", "position_propeller": "rad", "current_roll": "mA"}])
    frame["position_roll"], frame["current_roll"] = np.degrees(frame["position_roll"]), 1e3 * frame["current_roll"]
    pandas.concat([units, frame.astype(object)]).to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


def thousands(mark: str, point: str, sep: str) -> Callable[[Path], Path]:
    """Currents in mA with marks between thousands."""

    def make(folder: Path) -> Path:
        import pandas

        def cell(value: float) -> str:
            return f"{value:,.6f}".replace(",", "\0").replace(".", point).replace("\0", mark)

        columns = {"t": [cell(v) for v in TIME_s], "i": [cell(1e3 * v) for v in signal("current_roll")]}
        pandas.DataFrame(columns).to_csv(folder / "log.csv", index=False, sep=sep)
        return folder / "log.csv"

    return make


def dated(folder: Path) -> Path:
    """Times of day, and a text beside the numbers."""
    import pandas

    when = pandas.to_datetime(np.round((START_s + TIME_s) * 1e6).astype(np.int64), unit="us")
    pandas.DataFrame({"when": when, "q": SHORT["q"], "i": SHORT["i"], "phase": "scan"}).to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


def missing(word: str) -> Callable[[Path], Path]:
    """Every tenth current is missing."""
    columns = SHORT | {"i": np.where(np.arange(ROWS) % 10 == 3, np.nan, SHORT["i"])}
    return panda(columns, na_rep=word)


def polars_csv(folder: Path) -> Path:
    """By polars, with decimal commas."""
    import polars

    polars.DataFrame(SHORT).write_csv(folder / "log.csv", separator=";", decimal_comma=True)
    return folder / "log.csv"


def duck(what: str, file: str) -> Callable[[Path], Path]:
    """Return a maker with DuckDB's COPY."""

    def make(folder: Path) -> Path:
        import duckdb
        import pandas

        with duckdb.connect() as base:
            base.register("log", pandas.DataFrame(SHORT | {"status": STATUS}))
            when = (
                f"make_timestamp({round(START_s * 1e6)} + round(t * 1e6)::BIGINT) AS at, status::UINTEGER AS status, i::DECIMAL(18, 9) AS d"
            )
            base.execute(f"COPY (SELECT t, q, i, {when}, 'scan' AS phase FROM log) TO '{folder / file}' ({what})")
        return folder / file

    return make


def r(code: str) -> Callable[[Path], Path]:
    """Return a maker with R; the frame is `log`."""

    def make(folder: Path) -> Path:
        columns = f"t=t, q={FORMULAS['position_roll']}, i={FORMULAS['current_roll']}"
        log = f"t <- (0:{ROWS - 1})/{RATE_Hz}; log <- data.frame({columns})"
        subprocess.run(["Rscript", "--vanilla", "-e", f"options(digits=17); {log}; {code}"], cwd=folder, check=True, capture_output=True)
        return folder / "log.csv"

    return make


def octave_csv(folder: Path) -> Path:
    """By dlmwrite of Octave below a header of its own."""
    code = f"t=(0:{ROWS - 1})'/{RATE_Hz}; q={FORMULAS['position_roll']}; i={FORMULAS['current_roll']};"
    code += "f=fopen('log.csv','w'); fprintf(f,'t,q,i\\n'); fclose(f); dlmwrite('log.csv',[t q i],'-append','precision','%.15g');"
    subprocess.run(["octave-cli", "--eval", code], cwd=folder, check=True, capture_output=True)
    return folder / "log.csv"


def sqlite_csv(folder: Path) -> Path:
    """By the shell of SQLite."""
    with sqlite3.connect(folder / "log.sqlite") as base:
        base.execute("CREATE TABLE log (t REAL, q REAL, i REAL)")
        base.executemany("INSERT INTO log VALUES (?, ?, ?)", zip(*(values.tolist() for values in SHORT.values()), strict=True))
    script = f".headers on\n.mode csv\n.output {folder / 'log.csv'}\nSELECT * FROM log;\n"
    subprocess.run(["sqlite3", str(folder / "log.sqlite")], input=script, text=True, check=True)
    return folder / "log.csv"


def numpy_csv(folder: Path) -> Path:
    """By numpy.savetxt, which makes a comment of the header."""
    np.savetxt(folder / "log.csv", np.column_stack(list(SHORT.values())), delimiter=",", header="rig 3\nt,q,i", fmt="%.17g")
    return folder / "log.csv"


def standard_csv(**options: object) -> Callable[[Path], Path]:
    """Return a maker with the writer of Python."""

    def make(folder: Path) -> Path:
        with (folder / "log.csv").open("w", newline="") as file:
            writer = csv.writer(file, **options)
            writer.writerow(SHORT)
            writer.writerows(zip(*(values.tolist() for values in SHORT.values()), strict=True))
        return folder / "log.csv"

    return make


def pandas_parquet(folder: Path, **options: object) -> Path:
    import pandas

    when = pandas.to_datetime(round(START_s) * 10**9 + np.round(TIME_s * 1e9).astype(np.int64), unit="ns")
    frame = pandas.DataFrame(PLAIN | {"statusword_roll": STATUS, "phase": "scan"}).drop(columns="time")
    frame.index = pandas.Index(when, name="time")
    frame.to_parquet(folder / "log.parquet", **options)
    return folder / "log.parquet"


def arrow_parquet(folder: Path) -> Path:
    """By pyarrow: units in the columns' metadata, single precision, lists, dictionaries, several row groups."""
    import pyarrow as arrow
    from pyarrow import parquet

    columns = {
        "time": (arrow.array(np.round(1e3 * TIME_s, 6)), "ms"),
        "position_roll": (arrow.array(np.degrees(PLAIN["position_roll"]).astype(np.float32)), "deg"),
        "current_roll": (arrow.array(PLAIN["current_roll"]), "A"),
        "mode": (arrow.array(["jog"] * ROWS).dictionary_encode(), ""),
        "wrench": (arrow.array([[1.0, 2.0, 3.0]] * ROWS), "N"),
    }
    fields = [arrow.field(name, values.type, metadata={b"unit": unit.encode()}) for name, (values, unit) in columns.items()]
    table = arrow.table([values for values, _ in columns.values()], schema=arrow.schema(fields))
    parquet.write_table(table, folder / "log.parquet", row_group_size=100, compression="zstd")
    return folder / "log.parquet"


def polars_parquet(folder: Path) -> Path:
    import polars

    frame = polars.DataFrame(SHORT | {"status": STATUS.astype(np.uint16)})
    step = polars.Series("age", np.round(TIME_s * 1e6).astype(np.int64)).cast(polars.Duration("us"))
    frame.with_columns(step).write_parquet(folder / "log.parquet")
    return folder / "log.parquet"


def fast_parquet(folder: Path) -> Path:
    import fastparquet
    import pandas

    fastparquet.write(str(folder / "log.parquet"), pandas.DataFrame(PLAIN), compression="GZIP")
    return folder / "log.parquet"


def _csv(name: str, tool: str, make: Callable[[Path], Path], **more: object) -> Foreign:
    return Foreign(f"csv-{name}", "CSV", tool, make, **{"known": as_put_in()} | more)


def _short(name: str, tool: str, make: Callable[[Path], Path], within: float = 1e-12, **more: object) -> Foreign:
    return _csv(name, tool, make, **{"known": as_put_in(within, MAPPED), "maps": MAPS} | more)


_GAPS = {
    "position_roll": Known(SHORT["q"]),
    "current_roll": Known(np.where(np.arange(ROWS) % 10 == 3, np.nan, SHORT["i"])),
}
_THOUSANDS = {"known": {"current_roll": Known(SHORT["i"], 1e-9)}, "maps": ("t=time", "i=current_roll [mA]"), "time_within_s": 1e-6}
_STATUS = {"statusword_roll": Known(STATUS.astype(float))}
FILES = [
    _csv("plain", "pandas", panda()),
    _csv("index", "pandas", panda(index=True), left=("column without a name",)),
    _csv("semicolon-comma", "pandas", panda(sep=";", decimal=",")),
    _csv("tab", "pandas", panda(sep="\t")),
    _csv("quoted", "pandas", panda(quoting=csv.QUOTE_ALL)),
    _csv("quoted-comma", "pandas", panda(quoting=csv.QUOTE_ALL, decimal=",")),
    _csv("bom-crlf", "pandas", panda(encoding="utf-8-sig", lineterminator="\r\n")),
    _csv("utf-16", "pandas", panda(encoding="utf-16", sep="\t")),
    _csv("sep-line", "pandas", panda(before="sep=;\n", sep=";", decimal=",")),
    _csv("comments", "pandas", panda(before="# rig 3, second run\n# 2026-01-05\n")),
    _csv("exponents", "pandas", panda(float_format="%.9e"), known=as_put_in(1e-9), time_within_s=1e-9),
    _csv("rounded-time", "pandas", panda(float_format="%.5f"), known=as_put_in(5.1e-6), time_within_s=5.1e-6),
    _short("latin-1", "pandas",
           panda({"t": TIME_s, "q [°]": np.degrees(SHORT["q"]), "i": SHORT["i"]}, encoding="cp1252", sep=";", decimal=","),
           maps=("t=time", "q=position_roll [deg]", "i=current_roll")),
    _short("parentheses", "pandas", panda({"Time (ms)": 1e3 * TIME_s, "Angle (deg)": np.degrees(SHORT["q"]), "I/A": SHORT["i"]}),
           maps=("Time (ms)=time [ms]", "Angle (deg)=position_roll [deg]", "I/A=current_roll [A]")),
    _csv("units-row", "pandas", units_row),
    _csv("thousands-comma", "pandas", thousands(",", ".", ";"), **_THOUSANDS),
    _csv("thousands-quoted", "pandas", thousands(",", ".", ","), **_THOUSANDS),
    _csv("thousands-point", "pandas", thousands(".", ",", ";"), **_THOUSANDS),
    _csv("thousands-space", "pandas", thousands("\u202f", ",", ";"), **_THOUSANDS),
    _csv("thousands-apostrophe", "pandas", thousands("'", ".", ";"), **_THOUSANDS),
    _short("times-of-day", "pandas", dated, maps=("when=time", *MAPS[1:]), left=("phase",), time_within_s=1e-6),
    _short("missing-nan", "pandas", missing("NaN"), known=_GAPS),
    _short("missing-na", "pandas", missing("NA"), known=_GAPS),
    _short("missing-null", "pandas", missing("NULL"), known=_GAPS),
    _short("comma", "polars", polars_csv),
    _short("copy", "DuckDB", duck("HEADER", "log.csv"), left=("at", "phase")),
    _short("copy-bar", "DuckDB", duck("HEADER, DELIMITER '|'", "log.csv"), left=("at", "phase")),
    _short("write.csv", "R", r("write.csv(log, 'log.csv')")),
    _short("write.csv2", "R", r("write.csv2(log, 'log.csv', row.names=FALSE)")),
    _short("write.table", "R", r("log$i[4] <- NA; write.table(log, 'log.csv', sep='\\t')"),
           known=_GAPS | {"current_roll": Known(np.where(np.arange(ROWS) == 3, np.nan, SHORT["i"]))}),
    _short("dlmwrite", "Octave", octave_csv),
    _short("savetxt", "NumPy", numpy_csv),
    _short("shell", "SQLite", sqlite_csv),
    _short("unix", "Python", standard_csv(dialect="unix")),
    _short("old-lines", "Python", standard_csv(lineterminator="\r")),
    Foreign("parquet-pandas", "Parquet", "pandas", pandas_parquet, as_put_in() | _STATUS, left=("phase",), time_within_s=2e-9),
    Foreign("parquet-pyarrow", "Parquet", "pyarrow", arrow_parquet, as_put_in(SINGLE, MAPPED), left=("mode", "wrench")),
    Foreign("parquet-polars", "Parquet", "polars", polars_parquet, as_put_in(names=MAPPED) | _STATUS,
            maps=("age=time", *MAPS[1:], "status=statusword_roll"), left=("t",), time_within_s=1e-6),
    Foreign("parquet-duckdb", "Parquet", "DuckDB", duck("FORMAT parquet", "log.parquet"), as_put_in(names=MAPPED) | _STATUS,
            maps=("at=time", *MAPS[1:], "status=statusword_roll"), left=("t", "phase"), time_within_s=1e-6),
    Foreign("parquet-duckdb-decimal", "Parquet", "DuckDB", duck("FORMAT parquet, COMPRESSION zstd", "log.parquet"),
            {"current_roll": Known(SHORT["i"], 1e-9)}, maps=("t=time", "d=current_roll [A]"), left=("q", "i", "at", "phase", "status")),
    Foreign("parquet-fastparquet", "Parquet", "fastparquet", fast_parquet, as_put_in()),
]  # fmt: skip
