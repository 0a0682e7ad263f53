"""`gyrocal certify`: the dossier of a unit as page, JSON, coefficient file and (with weasyprint) PDF."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gyrocal
from gyrocal.calibration.dossier import Dossier
from gyrocal.calibration.limits import Row
from gyrocal.calibration.material import Material
from gyrocal.calibration.provenance import source_sha256
from gyrocal.calibration.summary import said, verdict
from gyrocal.errors import InputError
from gyrocal.report.drawings import DRAWINGS
from gyrocal.report.page import Page, Picture, Table, Tone, render_page
from gyrocal.report.style import render

#: Pictures of a certificate, of those of a report.
_SHOWN = ("figure_1", "figure_3b", "residual_map", "allan_deviation")

#: The judgements of a table.
_TONES: Mapping[str, Tone] = {"pass": "good", "fail": "bad", "open": "warning", "not tested": "warning"}


def certificate_files(
    dossier: Dossier, newest: Material, pdf: bool, tell: Callable[[float, str], None]
) -> dict[str, bytes | str]:
    """Name to contents of what is written; `newest` is the newest run with its own coefficients."""
    text = render_page(certificate_page(dossier, _pictures(newest)))
    files: dict[str, bytes | str] = {
        "certificate.html": text,
        "certificate.json": json.dumps(to_json(dossier), indent=1) + "\n",
        "coefficients.json": dossier.runs[-1].calibration.coefficients.to_text(),
    }
    if pdf:
        tell(0.9, "PDF")
        files["certificate.pdf"] = _pdf(text)
    return files


def _pictures(material: Material) -> list[Picture]:
    pictures = []
    for drawing in DRAWINGS:
        if drawing.name in _SHOWN:
            drawn = drawing.draw(material)
            png = None if isinstance(drawn, str) else render(drawn, "png")
            missing = drawn if isinstance(drawn, str) else ""
            pictures.append(Picture(drawing.name, drawing.title, drawing.caption, png, missing))
    return pictures


def certificate_sentence(dossier: Dossier) -> tuple[str, Tone]:
    """The verdict, and how it is meant; what was measured by expired instruments does not look good."""
    sentence, tone = _verdict(dossier)
    if not dossier.expired:
        return sentence, tone
    return f"{sentence} NOT TRACEABLE: {'; '.join(dossier.expired)}.", "bad" if tone == "bad" else "warning"


def _verdict(dossier: Dossier) -> tuple[str, Tone]:
    limited = [row for row in dossier.rows if row.judgement is not None]
    fit = f"Newest run: {verdict(dossier.runs[-1].calibration)}."
    parts = []
    if dossier.failed:
        parts.append(f"FAIL: beyond the limit with all of its uncertainty: {_names(dossier.failed)}.")
    if dossier.undecided:
        parts.append(f"NOT DECIDED: {_undecided(dossier)}.")
    if parts:
        return " ".join([*parts, fit]), "bad" if dossier.failed else "warning"
    if limited:
        return f"PASS: all {len(limited)} limits are kept with all of their uncertainty. {fit}", "good"
    return f"CALIBRATED; no limits were given. {fit}", "plain"


def _undecided(dossier: Dossier) -> str:
    """Where the measurement does not carry a judgement, and where there is none."""
    groups = {
        "the uncertainty reaches over the limit": [r for r in dossier.undecided if r.judgement == "open"],
        "not tested": [r for r in dossier.undecided if r.judgement == "not tested"],
    }
    return "; ".join(f"{what}: {_names(rows)}" for what, rows in groups.items() if rows)


def _names(rows: Sequence[Row]) -> str:
    return ", ".join(row.known.title for row in rows)


def certificate_page(dossier: Dossier, pictures: list[Picture]) -> Page:
    """The page: identity and verdict, figures, pictures, what was not tested, limits of the data, provenance."""
    sentence, tone = certificate_sentence(dossier)
    serial = dossier.identity["Serial number"]
    table = Table("figures", "Figures, with 95 % intervals", *figure_rows(dossier), csv="", tones=_TONES)
    untested = Table("not_tested", "Not tested", ("what",), [(text,) for text in dossier.not_tested], csv="")
    return Page(
        title=f"Certificate of calibration: {dossier.identity['Gyro']}, serial number {serial}",
        verdict=sentence,
        key_figures=list(dossier.identity.items()),
        remarks=[
            "Figures are named after IEEE Std 952. After: on data that the fit has not seen. An interval that reaches over a "
            "limit decides nothing."
        ],
        pictures=pictures,
        tables=[untested, _definitions(dossier)],
        lead=[table],
        quality=dossier.quality,
        tone=tone,
        banner="SIMULATED: NOTHING WAS MEASURED" if dossier.simulated else "",
        provenance=provenance(dossier),
        beside="certificate.json holds everything with all digits; coefficients.json is the newest run's.",
    )


def figure_rows(dossier: Dossier) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Columns and rows of the table of figures."""
    limited = any(row.judgement for row in dossier.rows)
    columns = ("figure", *(("verdict", "limit") if limited else ()), "before", "after", "unit")
    return columns, [_cells(row, limited) for row in dossier.rows]


def _cells(row: Row, limited: bool) -> tuple[str, ...]:
    known = row.known
    before = "does not apply" if row.before is None else said(row.before)
    after = said(row.after) if row.after is not None else "-" if before == "-" else "the same"
    judged = (row.judgement or "", row.limit.replace(f" {known.unit}", "")) if limited else ()
    return (known.title, *judged, before, after, known.unit)


def _definitions(dossier: Dossier) -> Table:
    """What each figure is, how it was found, and from what."""
    columns = ("figure", "definition", "method", "sample")
    rows = [(k.title, k.definition, k.method, k.sample) for k in (row.known for row in dossier.rows)]
    return Table("definitions", "What the figures are", columns, rows, csv="")


def provenance(dossier: Dossier) -> dict[str, str]:
    """Checksums of what was read, and the program."""
    entries = {"Software": f"gyrocal {gyrocal.__version__}"}
    for run in dossier.runs:
        entries[f"{run.path.name}, sha256"] = run.calibration.recording.sha256
    entries |= {f"{r.path.name}, sha256": source_sha256(r.path) for r in dossier.at_rest}
    heads = [(r.path, r.head) for r in dossier.runs] + [(r.path, r.head) for r in dossier.at_rest]
    for path, head in heads:
        if "profile_sha256" in head:
            entries[f"{path.name}, profile sha256"] = str(head["profile_sha256"])
    return entries


def to_json(dossier: Dossier) -> dict[str, Any]:
    """``gyrocal-certificate/1``."""
    sentence, _ = certificate_sentence(dossier)
    return {
        "schema": "gyrocal-certificate/1",
        "verdict": sentence,
        "expired": list(dossier.expired),
        "simulated": dossier.simulated,
        "identity": dict(dossier.identity),
        "figures": {
            row.known.name: {
                "before": None if row.before is None else row.before.to_json(),
                "after": None if row.after is None else row.after.to_json(),
                "limit": row.limit or None,
                "judgement": row.judgement,
            }
            for row in dossier.rows
        },
        "not_tested": list(dossier.not_tested),
        "quality": list(dossier.quality),
        "provenance": provenance(dossier),
    }


def _pdf(text: str) -> bytes:
    logging.getLogger("weasyprint").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        # of what its own next release will need from the system, which does not concern a reader of certificates
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            import weasyprint
        except (ImportError, OSError) as error:
            raise InputError(f"--pdf needs the extra: pip install 'gyrocal[pdf]' ({error}).") from error
        return bytes(weasyprint.HTML(string=text).write_pdf())
