"""Images of PAVE's scenes by Mitsuba 3: making them, storing them, reading them back.

SPDX-License-Identifier: BSD-3-Clause
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
import re
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from image_statistics import Estimate, Limits

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "scenes"
FOLDER = ROOT / "tests" / "data" / "mitsuba"
MANIFEST = FOLDER / "manifest.json"
VERSION = "3.9.1"

AOVS = {"albedo": 3, "normal": 3, "distance": 1, "position": 3}
AOV_RUNS = 16
AOV_SPEC = "albedo:albedo,normal:sh_normal,distance:depth,position:position"


@dataclass(frozen=True)
class Recipe:
    """How a reference is made: `runs` images with seeds 0, 1, ... of `spp` samples a pixel each."""

    scene: str
    width: int
    height: int
    runs: int
    spp: int
    aov_spp: int = 256

    @property
    def defines(self) -> dict[str, str]:
        """The scene file's parameters for this size."""
        square = "size" in re.findall(r'<default name="(\w+)"', self.scene_path.read_text())
        if square:
            return {"size": str(self.width)}
        return {"width": str(self.width), "height": str(self.height)}

    @property
    def scene_path(self) -> Path:
        return SCENES / f"{self.scene}.xml"

    @property
    def path(self) -> Path:
        return FOLDER / f"{self.scene}.npz"


RECIPES = {
    recipe.scene: recipe
    for recipe in (
        Recipe("cornell", 64, 64, runs=48, spp=1024),
        Recipe("novel", 64, 64, runs=32, spp=512),
        Recipe("materials", 64, 48, runs=48, spp=512),
        Recipe("many-lights", 64, 48, runs=32, spp=512),
        Recipe("textures", 64, 48, runs=48, spp=512),
        Recipe("envmap", 64, 48, runs=48, spp=1024),
        Recipe("instances", 64, 48, runs=48, spp=512),
    )
}

# For images whose variance is estimated from 16 runs: Student's t instead of the normal
# distribution, whose tails beyond 5 deviations hold some 1e-4 of the values.
# Their mean's own deviation is a tenth of a percent, so its limit is that of z.
FEW_RUNS = Limits(passing=0.997, mean=0.005, block=5.5)


def scene_sha256(recipe: Recipe) -> str:
    """Of the scene file and the meshes it names, in order."""
    text = recipe.scene_path.read_text()
    digest = hashlib.sha256(text.encode())
    for name in re.findall(r'name="filename" value="([^"]+)"', text):
        digest.update((SCENES / name).read_bytes())
    return digest.hexdigest()


def import_mitsuba():
    """Mitsuba in its LLVM variant, or the scalar one where LLVM is missing; the images are alike."""
    found = sorted(
        glob.glob("/usr/lib/*/libLLVM.so.*") + glob.glob("/usr/lib/*/libLLVM-1[5-9]*.so*")
    )
    if found:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", found[-1])
    import mitsuba

    try:
        mitsuba.set_variant("llvm_ad_rgb")
        mitsuba.Float(1.0) + 1.0  # loads LLVM
    except Exception:
        mitsuba.set_variant("scalar_rgb")
    return mitsuba


def load(recipe: Recipe, path: Path | None = None, **changes: str):
    """The recipe's scene in Mitsuba, at the recipe's size; `path` and `changes` seed faults."""
    mitsuba = import_mitsuba()
    return mitsuba.load_file(str(path or recipe.scene_path), **{**recipe.defines, **changes})


def render_runs(scene, runs: int, spp: int, first_seed: int = 0, integrator=None) -> list:
    """Independent images as (H, W, C) float32."""
    mitsuba = import_mitsuba()
    images = []
    for seed in range(first_seed, first_seed + runs):
        arguments = {} if integrator is None else {"integrator": integrator}
        image = mitsuba.render(scene, spp=spp, seed=seed, **arguments)
        images.append(np.array(image, dtype=np.float32))
    return images


def render_aovs(scene, runs: int, spp: int) -> dict[str, Estimate]:
    """What the first hit is, averaged over each pixel; where nothing is hit Mitsuba counts zeros."""
    mitsuba = import_mitsuba()
    integrator = mitsuba.load_dict({"type": "aov", "aovs": AOV_SPEC})
    images = render_runs(scene, runs, spp, integrator=integrator)
    planes = sum(AOVS.values())
    estimate = Estimate.of_runs([image[..., -planes:] for image in images])
    split = np.cumsum(list(AOVS.values()))[:-1]
    means, variances = np.split(estimate.mean, split, 2), np.split(estimate.variance, split, 2)
    return {name: Estimate(*pair) for name, *pair in zip(AOVS, means, variances, strict=True)}


def make(recipe: Recipe) -> dict[str, np.ndarray]:
    """The arrays of a reference: `color`, `direct`, every AOV, each with its `_variance`."""
    scene = load(recipe)
    images = {"color": Estimate.of_runs(render_runs(scene, recipe.runs, recipe.spp))}
    # PAVE's "direct" is a path of at most two edges: emission seen and one scattering event.
    two_edges = import_mitsuba().load_dict({"type": "path", "max_depth": 2})
    runs = render_runs(scene, recipe.runs // 2, recipe.spp // 2, integrator=two_edges)
    images["direct"] = Estimate.of_runs(runs)
    images |= render_aovs(scene, AOV_RUNS, recipe.aov_spp)
    arrays = {}
    for name, estimate in images.items():
        arrays[name] = estimate.mean.astype(np.float32)
        arrays[f"{name}_variance"] = estimate.variance.astype(np.float32)
    return arrays


def store(recipe: Recipe, arrays: dict[str, np.ndarray], command: str) -> None:
    """Writes the file and its entry in the manifest."""
    mitsuba = import_mitsuba()
    FOLDER.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(recipe.path, **arrays)
    manifest = json.loads(MANIFEST.read_text()) if MANIFEST.exists() else {}
    manifest[recipe.scene] = {
        "file": recipe.path.name,
        "sha256": hashlib.sha256(recipe.path.read_bytes()).hexdigest(),
        "scene_sha256": scene_sha256(recipe),
        "recipe": asdict(recipe),
        "defines": recipe.defines,
        "mitsuba": mitsuba.__version__,
        "variant": mitsuba.variant(),
        "command": command,
    }
    MANIFEST.write_text(json.dumps(manifest, indent=2, sort_keys=True) + "\n")


class Reference:
    """A stored reference, verified. Raises ValueError if it is damaged or of another scene file."""

    def __init__(self, name: str) -> None:
        self.recipe = RECIPES[name]
        entry = json.loads(MANIFEST.read_text())[name]
        remedy = f"run: python tests/python/make_references.py {name}"
        if hashlib.sha256(self.recipe.path.read_bytes()).hexdigest() != entry["sha256"]:
            raise ValueError(f"{self.recipe.path.name} is damaged; {remedy}")
        if scene_sha256(self.recipe) != entry["scene_sha256"]:
            raise ValueError(f"the reference of {name}.xml is of another version of it; {remedy}")
        if asdict(self.recipe) != entry["recipe"]:
            raise ValueError(f"the reference of {name}.xml is of another recipe; {remedy}")
        with np.load(self.recipe.path, allow_pickle=False) as arrays:
            self._arrays = dict(arrays)

    def estimate(self, name: str = "color") -> Estimate:
        return Estimate(self._arrays[name], self._arrays[f"{name}_variance"])

    def sample_variance(self, name: str) -> np.ndarray:
        """Variance of a single sample of an AOV, by pixel."""
        samples = AOV_RUNS * self.recipe.aov_spp
        return self._arrays[f"{name}_variance"].astype(np.float64) * samples
