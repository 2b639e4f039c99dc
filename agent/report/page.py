"""The report as one HTML page that needs no other file, no script and no network."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from typing import TYPE_CHECKING, Any, Final

from agent.report.picture import Picture
from agent.report.results import Results
from agent.report.tables import WORDS, Line, Table, lines, tables

if TYPE_CHECKING:
    from agent.telemetry.row.event import Event

STYLE: Final = """
:root { color-scheme: light; --ink: #1d2125; --dim: #5c636b; --rule: #dfe3e8; --good: #1c6b32; --bad: #b3261e; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2rem 1.5rem 4rem; max-width: 66rem; background: #fff; color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.15rem; margin: 2.4rem 0 .6rem; }
p { margin: .4rem 0; } .dim { color: var(--dim); }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; font-size: .92rem; }
th, td { text-align: right; padding: .32rem .7rem .32rem 0; border-bottom: 1px solid var(--rule); vertical-align: top; }
th { font-weight: 600; color: var(--dim); border-bottom-width: 2px; }
th:first-child, td:first-child, .words th, .words td { text-align: left; }
.results { max-width: 44rem; } .results td:nth-child(2) { font-weight: 600; }
.verdict { font-weight: 600; white-space: nowrap; } .met { color: var(--good); } .not_met { color: var(--bad); }
.scroll { overflow-x: auto; }
ul.missing { border-left: 4px solid #d9a300; margin: 1rem 0; padding: .5rem 1rem .5rem 2rem; background: #fff9e6; }
figure { margin: 0 0 2rem; } figure img { width: 100%; max-width: 1008px; height: auto; display: block; }
figcaption { color: var(--dim); font-size: .92rem; max-width: 60rem; } figcaption b { color: var(--ink); }
code { font: .86em ui-monospace, "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; }
@media (max-width: 44rem) { body { padding: 1rem .8rem 3rem; } figure { overflow-x: auto; }
  figure img { width: 38rem; max-width: none; } #start img { width: 100%; } }
@media print { body { padding: 0; max-width: none; font-size: 10.5pt; } @page { margin: 16mm; }
  figure img { max-height: 108mm; width: auto; max-width: 100%; } table { font-size: 8.5pt; }
  figure, tr, ul { break-inside: avoid; } h2 { break-after: avoid; } .scroll { overflow: visible; } }
"""


def render(results: Results, images: Sequence[tuple[Picture, bytes]], events: Sequence[Event]) -> str:
    """The whole page; `images` are the PNGs in their order, `events` those of the log."""
    info = results.info
    title = f"Run of {info.cell}"
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="dim">{escape(_summary(results))}</p>',
        _missing(results.missing),
        _results(lines(results)),
        "<h2>Figures</h2>" if images else "",
        *(figure_html(picture, png) for picture, png in images),
        *(table_html(table) for table in tables(results)),
        _events(events),
        _provenance(results),
    ]
    return document(title, body)


def document(title: str, body: Sequence[str]) -> str:
    """A page of parts that are HTML already."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in body if part)
        + "\n</body>\n</html>\n"
    )


def _summary(results: Results) -> str:
    info = results.info
    arms = ", ".join(f"{arm.name} ({arm.model})" for arm in info.arms)
    law = str(info.controller.get("kind", "unknown"))
    servos = f"on {'emulated' if info.emulated else 'real'} servos"
    where = {"sim": "in simulation", "dynamixel": servos}.get(info.driver, f"with driver {info.driver}")
    if results.rehearsing:
        where = f"in a rehearsal of {', '.join(results.rehearsing)} with a simulated object"
    return (
        f"{info.duration_s:g} s at {info.rate_hz:g} Hz {where}, {law} law, arms {arms}. "
        f"Errors are of the {results.error_source}, from {info.transient_s:g} s on."
    )


def _missing(missing: Sequence[str]) -> str:
    if not missing:
        return ""
    items = "".join(f"<li>{escape(text)}</li>" for text in missing)
    return f'<ul class="missing">{items}</ul>'


def _results(rows: Sequence[Line]) -> str:
    def verdict(line: Line) -> str:
        if line.verdict is None:
            return "<td></td>"
        return f'<td class="verdict {line.verdict.name.lower()}">{WORDS[line.verdict]}</td>'

    body = "".join(
        f"<tr><td>{escape(r.what)}</td><td>{escape(r.figure)}</td><td>{escape(r.bound)}</td>{verdict(r)}</tr>"
        for r in rows
    )
    head = "<tr><th>result</th><th>figure</th><th>bound</th><th>verdict</th></tr>"
    return f'<h2>Results</h2><table class="results"><thead>{head}</thead><tbody>{body}</tbody></table>'


def table_html(table: Table) -> str:
    """A table with its heading; it scrolls where the page is narrower."""
    head = "".join(f"<th>{_symbols(h)}</th>" for h in table.header)
    body = "".join("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in table.rows)
    words = ' class="words"' if table.words else ""
    return (
        f'<h2>{escape(table.title)}</h2><div class="scroll"><table{words}><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def figure_html(picture: Picture, png: bytes) -> str:
    """A picture in the page itself, with its caption."""
    data = base64.b64encode(png).decode("ascii")
    return (
        f'<figure id="{escape(picture.stem)}"><img src="data:image/png;base64,{data}" alt="{escape(picture.title)}">'
        f"<figcaption><b>{escape(picture.title)}.</b> {_symbols(picture.caption)}</figcaption></figure>"
    )


def pictures_in(page: bytes) -> list[str]:
    """The names of the files that `write_report` has put beside this page of its own, one per picture in it."""
    found = re.findall(rb'<figure id="(\w+)"><img src="data:image/png;base64,', page)
    return [f"{stem.decode()}.png" for stem in found]


def _symbols(text: str) -> str:
    return re.sub(r"\b([eu])_(\w)\b", r"<i>\1</i><sub>\2</sub>", escape(text))


def _events(events: Sequence[Event]) -> str:
    if not events:
        return "<h2>Events</h2><p>None.</p>"

    def row(event: Event) -> tuple[str, ...]:
        utc = datetime.fromtimestamp(event.utc_ns * 1e-9, UTC).isoformat(" ", "milliseconds").removesuffix("+00:00")
        data = ", ".join(f"{k} {_cell(v)}" for k, v in event.data.items())
        return utc, event.source, event.level.name, event.text, data

    header = ("UTC", "source", "level", "what", "figures")
    return table_html(Table("Events", header, tuple(row(event) for event in events), words=True))


def _provenance(results: Results) -> str:
    info = results.info
    pairs = {
        "cell": info.cell,
        "fingerprint": info.fingerprint,
        "driver": info.driver,
        **{
            f"controller {k}": v for k, v in _settings(info.controller) if info.adaptive or not k.startswith("adaptive")
        },
        **{f"reality {k}": v for k, v in _settings(info.reality)},
        **{f"simulated {k}": v for k, v in info.befell.items()},
        "host": info.host,
        **{f"version of {k}": v for k, v in info.versions.items()},
    }
    body = "".join(f"<tr><td>{escape(k)}</td><td><code>{escape(v)}</code></td></tr>" for k, v in pairs.items())
    return f'<h2>Where it comes from</h2><table class="words"><tbody>{body}</tbody></table>'


def _settings(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Every setting with its dotted name; what is not set is left out."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _settings(value, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", _cell(value)


def _cell(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
