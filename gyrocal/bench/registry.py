"""Every device that a profile can name: its options, its driver, and the same wire seen from the device.

Other packages add theirs by entry points (`gyrocal.extensions`).
"""

from __future__ import annotations

from gyrocal.bench.chambers import espec, manual, watlow_f4, watlow_f4t, weiss
from gyrocal.bench.gyros import ascii_line, dsp3000, ecore2000, kvh_frame, vn100
from gyrocal.bench.kinds import ChamberKind, GyroKind, TableKind
from gyrocal.bench.tables import acutrol, aerosmith, json_lines, zaber
from gyrocal.bench.tables import manual as manual_table
from gyrocal.extensions import extended


def _encode_ecore(
    rate_dps: float, temp_c: float, count: int, options: ecore2000.Options, good: bool = True
) -> bytes:
    sign = 1.0 if options.counter_clockwise_positive else -1.0
    other = bytearray(ecore2000.OTHER)
    if options.temperature_byte:
        counts = round((temp_c - options.temperature_zero_c) / options.temperature_lsb_c)
        other[options.temperature_byte - 1] = min(max(counts, 0), 255)
    return ecore2000.encode(round(sign * rate_dps / options.lsb_dps), bytes(other))


def _encode_ascii(
    rate_dps: float, temp_c: float, count: int, options: ascii_line.Options, good: bool = True
) -> bytes:
    status = options.status_good if good else options.status_good + 1.0
    sequence = count % (options.sequence_modulus or 1 << 30)
    return ascii_line.encode(options, rate=rate_dps, temp=temp_c, status=status, sequence=sequence)


_GYROS = {
    "kvh-ecore2000": GyroKind(ecore2000.Options, ecore2000.ECore2000Decoder, _encode_ecore, 9600, False),
    "kvh-dsp3000": GyroKind(
        dsp3000.Options,
        dsp3000.Dsp3000Decoder,
        lambda rate_dps, temp_c, count, options, good=True: dsp3000.encode(
            rate_dps, valid=good, options=options
        ),
        38400,
        False,
        # No acknowledgement exists, so the mode command goes out three times.
        (dsp3000.COMMAND_RATE * 3,),
    ),
    "kvh-frame-a": GyroKind(
        kvh_frame.Options,
        kvh_frame.KvhFrameDecoder,
        lambda rate_dps, temp_c, count, options, good=True: kvh_frame.encode(
            rate_dps, temp_c, count, options, valid=good
        ),
        921600,
        True,
    ),
    "kvh-frame-b": GyroKind(
        kvh_frame.Options,
        kvh_frame.KvhFrameDecoder,
        lambda rate_dps, temp_c, count, options, good=True: kvh_frame.encode(
            rate_dps,
            temp_c,
            count,
            options,
            time_us=round(count * 1e6 / options.data_rate_hz),
            valid=good,
        ),
        921600,
        True,
    ),
    "vn100": GyroKind(
        vn100.Options,
        vn100.Vn100Decoder,
        lambda rate_dps, temp_c, count, options, good=True: vn100.encode(rate_dps, temp_c, options),
        115200,
        True,
        (vn100.command("VNWRG,06,19"),),
        at_once=False,
    ),
    "ascii-line": GyroKind(ascii_line.Options, ascii_line.AsciiLineDecoder, _encode_ascii, 115200, True),
}
#: Gyros that gyrocal itself knows.
OWN_GYROS = frozenset(_GYROS)
GYROS: dict[str, GyroKind] = extended("gyrocal.gyros", GyroKind, _GYROS)

TABLES: dict[str, TableKind] = extended(
    "gyrocal.tables",
    TableKind,
    {
        "aerosmith": TableKind(
            aerosmith.Options, aerosmith.AerosmithTable, aerosmith.AerosmithResponder, 9600
        ),
        "zaber": TableKind(zaber.Options, zaber.ZaberTable, zaber.ZaberResponder, 115200),
        "acutrol": TableKind(acutrol.Options, acutrol.AcutrolTable, acutrol.AcutrolResponder, 9600),
        "json-lines": TableKind(
            json_lines.Options, json_lines.JsonLinesTable, json_lines.JsonLinesResponder, 115200
        ),
    },
)

CHAMBERS: dict[str, ChamberKind] = extended(
    "gyrocal.chambers",
    ChamberKind,
    {
        "espec": ChamberKind(espec.Options, espec.EspecChamber, espec.EspecResponder, 9600, sets_alarms=True),
        "watlow-f4": ChamberKind(
            watlow_f4.Options, watlow_f4.WatlowF4Chamber, watlow_f4.watlow_f4_responder, 19200
        ),
        "watlow-f4t-scpi": ChamberKind(
            watlow_f4t.Options,
            watlow_f4t.WatlowF4tScpiChamber,
            watlow_f4t.WatlowF4tScpiResponder,
            38400,
            True,
        ),
        "watlow-f4t-modbus": ChamberKind(
            watlow_f4t.Options,
            watlow_f4t.WatlowF4tModbusChamber,
            watlow_f4t.watlow_f4t_modbus_responder,
            38400,
        ),
        "weiss": ChamberKind(weiss.Options, weiss.WeissChamber, weiss.WeissResponder, 9600),
    },
)

#: Devices without a wire: a person reads and sets them.
MANUAL_TABLE = (manual_table.Options, manual_table.ManualTable)
MANUAL_CHAMBER = (manual.Options, manual.ManualChamber)
