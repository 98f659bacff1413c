"""Plants physics bugs in copies of the kernels, one at a time, and demands that the tests notice each.

SPDX-License-Identifier: BSD-3-Clause

`./pave test --seeded`. A test that cannot fail is no test: every bug here is one that a renderer has had or could
have, and names the tests that must fail with it. Kernels are read from disk (PAVE_KERNEL_DIR), so nothing is built.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
KERNELS = ROOT / "kernels"
PROGRAM = ROOT / "build" / "tests" / "test_render"
LIMIT_S = 400  # one run of one bug's tests


@dataclass(frozen=True)
class Bug:
    """`old`, which occurs once in the file, becomes `new`.

    `tests` says which must notice: GoogleTest filters joined by `:`, and pytest ids that begin with `python:`.
    """

    name: str
    file: str
    old: str
    new: str
    tests: str

    def plant(self, kernels: Path) -> None:
        """Edits the copy; ValueError if the text is not there exactly once."""
        path = kernels / self.file
        text = path.read_text(encoding="utf-8")
        count = text.count(self.old)
        if count != 1:
            raise ValueError(f"{self.file} has the text to replace {count} times, not once")
        path.write_text(text.replace(self.old, self.new), encoding="utf-8")


MITSUBA = "python:test_physics_mitsuba.py::test_image_is_mitsubas[cornell]"
BUGS = (
    # Estimator
    Bug(
        "roulette without division",
        "path.cl",
        "roulette ? reciprocal(survival) : splat(1.0f)",
        "splat(1.0f)",
        "Furnace.RouletteKeepsTheMean",
    ),
    Bug(
        "MIS weights swapped",
        "light.h",
        "vmin(other, splat(3e38f)) * reciprocal(pdf)",
        "pdf * reciprocal(vmin(other, splat(3e38f)))",
        "DirectLight.UnitSquareAtDistanceOne:DirectLight.PointLightAndSky",
    ),
    Bug(
        "no MIS weight on emission",
        "path.cl",
        "mul3(paths->throughput, scale3(l.radiance, weight)));",
        "mul3(paths->throughput, l.radiance));",
        "DirectLight.UnitSquareAtDistanceOne:DirectLight.RandomPolygonsFollowLambertsFormula",
    ),
    Bug(
        "light sample's MIS weight left out",
        "path.cl",
        "const vfloat weight = ls.delta ? alone : by_both;",
        "const vfloat weight = alone;",
        "DirectLight.UnitSquareAtDistanceOne:DirectLight.RandomPolygonsFollowLambertsFormula",
    ),
    Bug(
        "one edge too many",
        "path.cl",
        "(paths->depth + 1 < limit)",
        "(paths->depth < limit)",
        "Furnace.HoldsForEveryDepth",
    ),
    Bug(
        "shadow rays that see through",
        "path.cl",
        "useful & lane_not(blocked), paths->depth == 0",
        "useful, paths->depth == 0",
        "Furnace.HidesGlassMirrorsAndSmoothMeshes:" + MITSUBA,
    ),
    Bug(
        "direct light counts one bounce too many",
        "path.cl",
        "const vmask is_direct = paths->depth <= 1;",
        "const vmask is_direct = paths->depth <= 2;",
        "Channels.DirectIsTheImageOfTwoEdges",
    ),
    Bug(
        "half a pixel off",
        "schedule.h",
        "const vfloat y = (float)w->row + unit_float(n.y);",
        "const vfloat y = (float)w->row + 0.5f + unit_float(n.y);",
        "Channels.PlaneIsWhereGeometryPutsIt:Channels.OnePixelIsExact",
    ),
    # Random numbers
    Bug(
        "vertices share their numbers",
        "sampler.h",
        "(splat_uint(1u) + ((depth) << 1)) /* x, y: light",
        "(splat_uint(1u) + ((depth) & 0u)) /* x, y: light",
        MITSUBA,
    ),
    Bug(
        "roulette reuses the direction's number",
        "path.cl",
        "(unit_float_of_rest(n.u) < survival)",
        "(unit_float(n.u.z) < survival)",
        MITSUBA,
    ),
    Bug(
        "all pixels draw the same numbers",
        "sampler.h",
        "    c.x = pixel;\n",
        "    c.x = splat_uint(0);\n",
        "Channels.VarianceIsThatOfTheMean:" + MITSUBA,
    ),
    Bug(
        "the seed is not used",
        "path.cl",
        "set_keys(&keys, params->seed_low, params->seed_high);",
        "set_keys(&keys, 0u, 0u);",
        "Repro.OtherSeedsAndFramesGiveOtherImages",
    ),
    Bug("a Philox constant off by one", "rng.h", "0xD2511F53", "0xD2511F52", "Lanes/Rng.*"),
    Bug(
        "Sobol table shared without its shift",
        "sampler.h",
        "n.u.x ^= tabled ? as_vuint(row.s0) : splat_uint(0);",
        "n.u.x = tabled ? as_vuint(row.s0) : n.u.x;",
        "Sobol.EveryNumberAloneIsUniform",
    ),
    Bug(
        "Sobol dimension used twice",
        "sampler.h",
        "n.u.y ^= tabled ? as_vuint(row.s1)",
        "n.u.y ^= tabled ? as_vuint(row.s0)",
        "DirectLight.UnitSquareAtDistanceOne:DirectLight.RandomPolygonsFollowLambertsFormula",
    ),
    # Samplers
    Bug(
        "cosine density without 1/pi",
        "sampling.h",
        "return vmax(w.z, splat(0.0f)) * INV_PI_F;",
        "return vmax(w.z, splat(0.0f));",
        "Bsdf.WeightIsValueOverDensity:Bsdf.MakesNoEnergy:SamplersOnce.*",
    ),
    Bug(
        "hemisphere drawn evenly",
        "sampling.h",
        "    w.z = safe_sqrt(1.0f - w.x * w.x - w.y * w.y);\n    return w;\n}\nstatic inline vfloat pdf_cosine",
        "    w.z = 1.0f - w.x * w.x - w.y * w.y;\n    return normalize3(w);\n}\nstatic inline vfloat pdf_cosine",
        "SamplersChi2.*",
    ),
    Bug(
        "triangle without its root",
        "sampling.h",
        "    const vfloat root = safe_sqrt(1.0f - u1);\n    *b1",
        "    const vfloat root = 1.0f - u1;\n    *b1",
        "SamplersChi2.*",
    ),
    Bug(
        "cone twice as dense as it is",
        "sampling.h",
        "return (0.5f * INV_PI_F) / height;",
        "return INV_PI_F / height;",
        "SamplersOnce.*",
    ),
    # Lights
    Bug(
        "area density without the cosine",
        "light.h",
        "return l->pdf_area * d2 * d * reciprocal(vabs(dot3(n, to)));",
        "return l->pdf_area * d2;",
        "DirectLight.UnitSquareAtDistanceOne",
    ),
    Bug(
        "light's area off by two",
        "light.h",
        "l.pdf_area = r1.s7;",
        "l.pdf_area = 2.0f * r1.s7;",
        "DirectLight.UnitSquareAtDistanceOne",
    ),
    Bug(
        "lights shine from both sides",
        "light.h",
        "keep((dot3(n_side, out.wi) < 0.0f) & (d2 > 0.0f), out.pdf)",
        "keep(d2 > 0.0f, out.pdf)",
        "Channels.LightHasOneSide:Light.*",
    ),
    Bug(
        "next light in the table",
        "light.h",
        "low = below ? low : min(middle + 1, high);",
        "low = below ? low : min(middle, high);",
        "Light.AreChosenByPower",
    ),
    Bug(
        "point light falls with the distance",
        "light.h",
        "scale3(l.radiance, reciprocal(squared))",
        "scale3(l.radiance, inverse_sqrt(squared))",
        "Light.PointLightFallsWithTheSquare",
    ),
    Bug(
        "sky's density without the sine",
        "environment.h",
        "return chance * cells / (2.0f * PI_F * PI_F * vmax(sine, splat(1e-20f)));",
        "return chance * cells / (2.0f * PI_F * PI_F);",
        "LightChi2.SamplesFollowTheirDensity",
    ),
    Bug(
        "sky turned the wrong way",
        "environment.h",
        "atan2(w.x, -w.z)",
        "atan2(-w.x, -w.z)",
        "Light.*:LightChi2.SamplesFollowTheirDensity",
    ),
    # Materials
    Bug(
        "masking left out of the conductor's weight",
        "rough_conductor.h",
        "scale3(f, ggx_g1(wo, h, m->alpha_u, m->alpha_v))",
        "f",
        "Bsdf.WeightIsValueOverDensity:Bsdf.MakesNoEnergy",
    ),
    Bug(
        "half vector's Jacobian off by two",
        "rough_conductor.h",
        "d * g_i / (4.0f * wi.z)",
        "d * g_i / (2.0f * wi.z)",
        "BsdfChi2.*",
    ),
    Bug(
        "facets drawn as if seen from above",
        "microfacet.h",
        "const vfloat z = mad_f(1.0f - u1, 1.0f + i.z, -i.z);",
        "const vfloat z = mad_f(1.0f - u1, 1.0f + i.z, -1.0f);",
        "BsdfChi2.*",
    ),
    Bug(
        "index of refraction upside down",
        "fresnel.h",
        "*eta_ti = outside ? inverse : eta;",
        "*eta_ti = outside ? eta : inverse;",
        "Bsdf.GlassObeysSnellAndFresnel",
    ),
    Bug(
        "glass without the squeeze of radiance",
        "bsdf.h",
        "scale3(m->transmittance, eta_ti * eta_ti)",
        "m->transmittance",
        "Bsdf.GlassObeysSnellAndFresnel:Furnace.HidesGlassMirrorsAndSmoothMeshes",
    ),
    Bug(
        "metal's parallel term forgotten",
        "fresnel.h",
        "return 0.5f * (r_s + r_p);",
        "return r_s;",
        "Bsdf.MetalsReflectByFresnel",
    ),
    Bug(
        "plastic's light inside lost",
        "plastic.h",
        "m->albedo.x * passed / (1.0f - again.x)",
        "m->albedo.x * passed",
        "Bsdf.PlasticReflectsByFresnelAndItsBase",
    ),
    Bug(
        "plastic's coat passed once only",
        "plastic.h",
        "(1.0f - f_i) * (1.0f - f_o) / (m->eta * m->eta)",
        "(1.0f - f_i) / (m->eta * m->eta)",
        "Bsdf.PlasticReflectsByFresnelAndItsBase",
    ),
    Bug(
        "rough glass: Jacobian of the mirror for what is refracted",
        "rough_dielectric.h",
        "(reflect ? mirrored : bent)",
        "mirrored",
        "BsdfChi2.*",
    ),
    Bug(
        "rough glass: lobe chosen evenly",
        "rough_dielectric.h",
        "const vmask reflect = u_lobe <= f;",
        "const vmask reflect = u_lobe <= 0.5f;",
        "BsdfChi2.*",
    ),
    Bug(
        "backs of one-sided materials reflect",
        "bsdf.h",
        "    vmask front = (wi.z > 0.0f) & (out.wo.z > 0.0f);",
        "    wi.z = vabs(wi.z);\n    vmask front = mask_of(1);",
        "Bsdf.BackOfOneSidedIsBlack",
    ),
    # Textures
    Bug(
        "texels are bytes, not colours",
        "texture.h",
        "(float4)(decoded[word & 0xffu],",
        "(float4)((float)(word & 0xffu) / 255.0f,",
        "Textures.AreLookedUpAsTheFormulaSays",
    ),
    Bug(
        "texture off by half a texel",
        "texture.h",
        "const float left = floor(x - 0.5f), top",
        "const float left = floor(x), top",
        "Textures.AreLookedUpAsTheFormulaSays",
    ),
    # Geometry
    Bug(
        "rays start on their surface",
        "vertex.h",
        "return mad3(n_geom, mul_sign(offset, dot3(n_geom, w)), p);",
        "return p;",
        MITSUBA,
    ),
    Bug(
        "rays start on the wrong side",
        "vertex.h",
        "mul_sign(offset, dot3(n_geom, w))",
        "-mul_sign(offset, dot3(n_geom, w))",
        "Furnace.HoldsForEveryDepth",
    ),
    Bug(
        "boxes without their slack",
        "tree.h",
        "#define BOX_SLACK 4.8e-7f",
        "#define BOX_SLACK 0.0f",
        "TraceWatertight.*",
    ),
    Bug(
        "shared edges belong to nobody",
        "tree.h",
        "const int8 inside = (least >= 0.0f) | (most <= 0.0f);",
        "const int8 inside = (least > 0.0f) | (most < 0.0f);",
        "TraceWatertight.*",
    ),
    Bug(
        "triangle's weights exchanged",
        "tree.h",
        "    *b1 = v * scale;\n    *b2 = w * scale;",
        "    *b1 = w * scale;\n    *b2 = v * scale;",
        "Lanes/Trace.*/1",
    ),
    Bug(
        "the farther child first, and the nearer dropped",
        "walk.h",
        "at->current = child[nearer];",
        "at->current = child[farther];",
        "Lanes/RayPaths.RaysTogether*/2",
    ),
    Bug(
        "rectangles along the axes reach too far",
        "axis_shapes.h",
        "return (vabs(x) <= s->reach[0])",
        "return (vabs(x) <= 1.1f * s->reach[0])",
        "Lanes/Trace.ShapesAlongTheAxes*/1:Lanes/Trace.ShapesAreTheSame*/1",
    ),
    Bug(
        "smooth normals are flat",
        "vertex.h",
        "    n_shade = smooth_normal(&r1, hit->b1, hit->b2, n_geom);\n",
        "",
        "Furnace.HidesGlassMirrorsAndSmoothMeshes:Lanes/Trace.*/1:Instances.NormalsAreAcrossTheMappedTriangles:"
        "Channels.VertexNormalsAreInterpolated",
    ),
    Bug(
        "instances' normals go by the map itself",
        "instance.h",
        "mad3(l0, n_geom->x, mad3(l1, n_geom->y, scale3(l2, n_geom->z)))",
        "vec3_of(dot3(m0, *n_geom), dot3(m1, *n_geom), dot3(m2, *n_geom))",
        "Instances.NormalsAreAcrossTheMappedTriangles",
    ),
    # Sums
    Bug(
        "variance of samples instead of the mean's",
        "film.h",
        "return gap * gap * (n_a * n_b / (n_a + n_b));",
        "return gap * gap * (n_a + n_b);",
        "Channels.VarianceIsThatOfTheMean:Channels.VarianceFallsAsOneOverSamples",
    ),
)


@dataclass(frozen=True)
class Verdict:
    """What the tests said: names of those that failed, or why they said nothing."""

    failed: tuple[str, ...] = ()
    trouble: str = ""


def failed_tests(output: str) -> tuple[str, ...]:
    """Names that GoogleTest or pytest lists as failed."""
    gtest, pytest_ = "[  FAILED  ] ", "FAILED "
    names = set()
    for line in output.splitlines():
        if line.startswith(gtest):
            names.add(line[len(gtest) :].split(",")[0].split(" (")[0])
        elif line.startswith(pytest_):
            names.add(line[len(pytest_) :].split(" - ")[0])
    return tuple(sorted(name for name in names if "." in name))


def run_tests(tests: str, kernels: Path, cache: Path) -> Verdict:
    environment = {**os.environ, "PAVE_KERNEL_DIR": str(kernels), "XDG_CACHE_HOME": str(cache)}
    filters, *ids = tests.split("python:")
    commands = [
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            f"tests/python/{each.strip(':')}",
        ]
        for each in ids
    ]
    if filters:
        commands.append([str(PROGRAM), f"--gtest_filter={filters.strip(':')}"])
    failed: tuple[str, ...] = ()
    for command in commands:
        done = subprocess.run(
            command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S
        )
        if "clBuildProgram" in done.stdout + done.stderr:
            return Verdict(trouble="the kernels do not compile")
        if done.returncode not in (0, 1):
            return Verdict(trouble=f"{command[0]} ended with status {done.returncode}")
        if not re.search(r"\b[1-9]\d* (tests? from|passed|failed)", done.stdout):
            return Verdict(trouble=f"no test has the name {tests}")
        failed += failed_tests(done.stdout)
    return Verdict(failed)


@dataclass(frozen=True)
class Outcome:
    bug: Bug
    verdict: Verdict
    seconds: float


def try_bug(bug: Bug, folder: Path) -> Outcome:
    begin = time.monotonic()
    kernels = Path(tempfile.mkdtemp(dir=folder)) / "kernels"
    shutil.copytree(KERNELS, kernels)
    try:
        bug.plant(kernels)
        verdict = run_tests(bug.tests, kernels, folder / "cache")
    except (ValueError, subprocess.TimeoutExpired) as error:
        verdict = Verdict(trouble=str(error))
    shutil.rmtree(kernels.parent)
    return Outcome(bug, verdict, time.monotonic() - begin)


def sound_kernels_pass(tests: str, folder: Path) -> bool:
    """A test that fails without a bug catches nothing."""
    verdict = run_tests(tests, KERNELS, folder / "cache")
    if verdict == Verdict():
        return True
    print(f"without a bug {tests} fails: {verdict.trouble or ', '.join(verdict.failed)}")
    return False


def report(outcome: Outcome) -> bool:
    verdict = outcome.verdict
    caught = bool(verdict.failed) and not verdict.trouble
    what = verdict.trouble or ", ".join(verdict.failed[:2]) or "nothing noticed it"
    mark = "caught " if caught else "ESCAPED"
    where = f"{outcome.bug.file}: {outcome.bug.name}"
    print(f"{mark} {where}: {what} ({outcome.seconds:.0f} s)", flush=True)
    return caught


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="./pave test --seeded", description=__doc__.split("\n")[0]
    )
    parser.add_argument("-k", "--filter", default="", help="bugs whose name or file has this in it")
    options = parser.parse_args(arguments)
    bugs = [bug for bug in BUGS if options.filter in f"{bug.file}: {bug.name}"]
    if not bugs:
        print(f"no bug has {options.filter!r} in its name")
        return 1
    if not PROGRAM.exists():
        print(f"{PROGRAM} is missing; build the tests first (./pave test does)")
        return 1
    with tempfile.TemporaryDirectory(prefix="pave-seeded-") as name:
        folder = Path(name)
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            filters = list({bug.tests: None for bug in bugs})
            if not all(pool.map(lambda tests: sound_kernels_pass(tests, folder), filters)):
                return 1
            caught = [report(outcome) for outcome in pool.map(lambda b: try_bug(b, folder), bugs)]
    print(f"{sum(caught)} of {len(bugs)} bugs were caught")
    return 0 if all(caught) else 1


if __name__ == "__main__":
    sys.exit(main())
