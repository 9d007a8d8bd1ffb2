"""An FMI 2.0 co-simulation unit with the C sources inside, for TwinCAT, Simulink and other importers that compile."""

import hashlib
import io
import zipfile
from xml.sax.saxutils import quoteattr

import numpy as np

from casadical.export.c.c_language import self_test_source
from casadical.export.c.c_source import common_values, header, source
from casadical.export.c.emit import filled, template
from casadical.export.c.language import Label, Language
from casadical.export.c.tape_program import TapeProgram

_DATE = (1980, 1, 1, 0, 0, 0)  # the same bytes each time

_STATE = "    @name@_state state;\n"
_RESET = """\
    for (i = 0U; i < @NAME@_JOINTS; i++)
    {
        it->state.dq[i] = (@name@_real)0;
    }
    it->state.gain = (@name@_real)0;
"""
_CALL, _CALL_STEP = "@name@_@function@(q, out)", "@name@_step(&it->state, q, (unsigned int)it->enable, out)"
_CYCLES = """\
    {
        /* as many controller cycles as fit the communication step */
        const double wanted = (size / @cycle_s@) + 0.5;
        const double most = (wanted < 100000.0) ? wanted : 100000.0;
        const unsigned int cycles = (most >= 1.0) ? (unsigned int)most : 1U;
        unsigned int i;
        for (i = 0U; i < cycles; i++)
        {
            call(it);
        }
    }
"""


class Fmu(Language):
    """The archive: modelDescription.xml and the C sources."""

    name = "fmu"

    def files(self, program: TapeProgram, label: Label) -> dict[str, bytes]:
        return {f"{label.name}.fmu": fmu(program, label)}


def fmu(program: TapeProgram, label: Label) -> bytes:
    name = label.name
    files = {
        f"sources/{name}.h": header(program, label),
        f"sources/{name}.c": source(program, label),
        f"sources/{name}_self_test.c": self_test_source(program, label),
        f"sources/{name}_fmu.c": _source(program, label),
    }
    digest = hashlib.sha256("".join(files[key] for key in sorted(files)).encode()).hexdigest()
    files["modelDescription.xml"] = _description(program, label, digest)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for key in sorted(files):
            entry = zipfile.ZipInfo(key, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, files[key])
    return buffer.getvalue()


def _output_count(program: TapeProgram) -> int:
    return program.n if program.command else len(program.network_bounds)


def _source(program: TapeProgram, label: Label) -> str:
    command = program.command
    values = common_values(program, label) | {"n_out": str(_output_count(program))}
    values["middle"] = ", ".join(repr(v) for v in _box_middle(program))
    values["state"] = filled(_STATE, values) if command else ""
    values["reset"] = filled(_RESET, values) if command else ""
    values["call"] = filled(_CALL_STEP if command else _CALL, values)
    values["do_step"] = filled(_CYCLES, values) if command else "    (void)size;\n    call(it);\n"
    values["initial"] = "" if command else "    call((instance *)c);\n"
    return filled(template("fmu.c"), values)


def _description(program: TapeProgram, label: Label, digest: str) -> str:
    name, command = label.name, program.command
    guid = f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"
    variables = [
        f'    <ScalarVariable name="q[{i + 1}]" valueReference="{i}" causality="input" variability="continuous" '
        f'description="commanded joint reading"><Real unit="{unit}" start="{v!r}"/></ScalarVariable>'
        for i, (v, unit) in enumerate(zip(_box_middle(program), program.product.units, strict=True))
    ]
    out, units, what = ("dq", program.product.units, "joint correction")
    if program.network is not None and command is None:
        out, what = program.network.out, program.network.title
        units = (program.network.unit,) * _output_count(program)
    variables += [
        f'    <ScalarVariable name="{out}[{i + 1}]" valueReference="{program.n + i}" causality="output" '
        f'variability="continuous" initial="calculated" description="{what}"><Real unit="{unit}"/></ScalarVariable>'
        for i, unit in enumerate(units)
    ]
    variables.append(
        '    <ScalarVariable name="status" valueReference="0" causality="output" variability="discrete" '
        'initial="calculated" description="0 is OK, see the C header"><Integer/></ScalarVariable>'
    )
    if command:
        variables.append(
            '    <ScalarVariable name="enable" valueReference="0" causality="input" variability="discrete" '
            'description="ramps the correction in and out"><Boolean start="true"/></ScalarVariable>'
        )
    outputs = range(program.n + 1, program.n + _output_count(program) + 2)
    unknowns = "\n".join(f'      <Unknown index="{k}"/>' for k in outputs)
    sources = "\n".join(f'      <File name="{name}{end}.c"/>' for end in ("_fmu", "", "_self_test"))
    return filled(
        template("modelDescription.xml"),
        {
            "name": name,
            "guid": guid,
            "description": quoteattr(f"model {label.model_sha256}, data {label.data_sha256}"),
            "sources": sources,
            "step": f"{command.limits.cycle_s:.6g}" if command else "0.004",
            "variables": "\n".join(variables),
            "unknowns": unknowns,
        },
    )


def _box_middle(program: TapeProgram) -> list[float]:
    """The middle of the box of joints, where the FMU starts."""
    return [float(v) for v in np.mean([program.product.lower, program.product.upper], axis=0)]
