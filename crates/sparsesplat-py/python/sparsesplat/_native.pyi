"""Types of the compiled part. README.md has shapes, units and errors."""

from os import PathLike
from typing import Any, Callable, Dict, List, Literal, Optional, Sequence, Tuple, TypedDict, Union

import numpy as np
from numpy.typing import NDArray

from ._gaussians import Gaussians

_Floats = NDArray[np.float32]
_Matrices = Union[NDArray[np.float32], NDArray[np.float64]]
_Device = Literal["auto", "gpu", "cpu"]
_RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]
_RasterizeMode = Literal["classic", "antialiased"]

class _Shared(TypedDict):
    viewmats: _Matrices
    backgrounds: Optional[_Floats]
    seconds: float

# By the arrays of `record`, or by those of `Scene.record`.
class _Gradients(_Shared, total=False):
    means: _Floats
    quats: _Floats
    scales: _Floats
    opacities: _Floats
    colors: _Floats
    geometry: _Floats
    sh: _Floats

def rasterize(
    means: _Floats,
    quats: _Floats,
    scales: _Floats,
    opacities: _Floats,
    colors: _Floats,
    viewmats: _Matrices,
    Ks: _Matrices,
    width: int,
    height: int,
    *,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    eps2d: float = 0.3,
    sh_degree: Optional[int] = None,
    backgrounds: Optional[_Floats] = None,
    render_mode: _RenderMode = "RGB",
    rasterize_mode: _RasterizeMode = "classic",
    device: _Device = "auto",
    alpha_min: float = 1 / 255,
    alpha_max: float = 0.99,
    transmittance_min: float = 1e-4,
    compensation_min: float = 0.005,
) -> Tuple[_Floats, _Floats, Dict[str, Any]]: ...
def record(
    means: _Floats,
    quats: _Floats,
    scales: _Floats,
    opacities: _Floats,
    colors: _Floats,
    viewmats: _Matrices,
    Ks: _Matrices,
    width: int,
    height: int,
    *,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    eps2d: float = 0.3,
    sh_degree: Optional[int] = None,
    backgrounds: Optional[_Floats] = None,
    render_mode: _RenderMode = "RGB",
    rasterize_mode: _RasterizeMode = "classic",
    device: _Device = "auto",
    alpha_min: float = 1 / 255,
    alpha_max: float = 0.99,
    transmittance_min: float = 1e-4,
    compensation_min: float = 0.005,
) -> Tuple[_Floats, _Floats, Dict[str, Any], Tape]: ...
def device(device: _Device = "auto") -> Tuple[str, Optional[str]]: ...
def reconstruct(
    source: Union[str, PathLike[str], Sequence[View]],
    gaussians: int = 40000,
    *,
    tau: Optional[float] = None,
    views: int = 6,
    size: Optional[Tuple[int, int]] = None,
    format: Optional[str] = None,
    backbone: Literal["plane-sweep", "given-depth"] = "plane-sweep",
    depth_planes: Optional[int] = None,
    depth_range: Union[None, Literal["hint"], Tuple[float, float]] = None,
    allocation: Literal["entropy", "laplacian", "random", "pixel-aligned", "merged", "voxel-aligned"] = "entropy",
    sampler: Literal["fixed", "bernoulli", "systematic"] = "fixed",
    filled_weight: Optional[float] = None,
    smooth_weight: Optional[float] = None,
    fuse: bool = False,
    head: Literal["default", "attention", "closed-form"] = "default",
    weights: Union[None, str, PathLike[str]] = None,
    looks: Optional[int] = None,
    far_shell: bool = True,
    exposure: Literal["as-photographed", "common"] = "as-photographed",
    neighbours: int = 20,
    refine: int = 0,
    corrector: Union[None, str, PathLike[str]] = None,
    seed: int = 0,
    device: _Device = "auto",
    progress: Optional[Callable[[str, float], object]] = None,
) -> Scene: ...
def simulated_views(width: int = 480, height: int = 320) -> Tuple[List[View], List[View]]: ...
def load_ply(path: Union[str, PathLike[str]]) -> Scene: ...
def knn(
    points: _Floats, k: int, queries: Optional[_Floats] = None
) -> Tuple[NDArray[np.uint32], _Floats]: ...
def entropy(
    image: Union[NDArray[np.uint8], _Floats],
    window: int = 7,
    levels: int = 256,
    border: Literal["reflect", "clip"] = "reflect",
) -> _Floats: ...
def psnr(a: Union[NDArray[np.uint8], _Floats], b: Union[NDArray[np.uint8], _Floats]) -> float: ...
def ssim(a: Union[NDArray[np.uint8], _Floats], b: Union[NDArray[np.uint8], _Floats]) -> float: ...

class View:
    def __init__(
        self,
        image: Union[NDArray[np.uint8], _Floats],
        viewmat: _Matrices,
        K: _Matrices,
        depth: Optional[_Floats] = None,
        name: str = "view",
    ) -> None: ...
    @property
    def image(self) -> _Floats: ...
    @property
    def viewmat(self) -> NDArray[np.float64]: ...
    @property
    def K(self) -> NDArray[np.float64]: ...
    @property
    def depth(self) -> Optional[_Floats]: ...
    @property
    def name(self) -> str: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...

class Scene:
    def __init__(
        self,
        means: _Floats,
        quats: _Floats,
        scales: _Floats,
        opacities: _Floats,
        colors: _Floats,
        sh_degree: Optional[int] = None,
    ) -> None: ...
    @staticmethod
    def from_stored(geometry: _Floats, sh: _Floats) -> Scene: ...
    @property
    def gaussians(self) -> Gaussians: ...
    @property
    def geometry(self) -> _Floats: ...
    @property
    def sh(self) -> _Floats: ...
    @property
    def sh_degree(self) -> int: ...
    @property
    def report(self) -> Optional[Dict[str, Any]]: ...
    @property
    def seconds(self) -> Optional[Dict[str, float]]: ...
    def render(
        self,
        viewmats: _Matrices,
        Ks: _Matrices,
        width: int,
        height: int,
        *,
        near_plane: Optional[float] = None,
        far_plane: float = 1e10,
        eps2d: float = 0.3,
        backgrounds: Optional[_Floats] = None,
        render_mode: _RenderMode = "RGB",
        rasterize_mode: _RasterizeMode = "classic",
        device: _Device = "auto",
        alpha_min: float = 1 / 255,
        alpha_max: float = 0.99,
        transmittance_min: float = 1e-4,
        compensation_min: float = 0.005,
    ) -> Tuple[_Floats, _Floats, Dict[str, Any]]: ...
    def record(
        self,
        viewmats: _Matrices,
        Ks: _Matrices,
        width: int,
        height: int,
        *,
        near_plane: Optional[float] = None,
        far_plane: float = 1e10,
        eps2d: float = 0.3,
        backgrounds: Optional[_Floats] = None,
        render_mode: _RenderMode = "RGB",
        rasterize_mode: _RasterizeMode = "classic",
        device: _Device = "auto",
        alpha_min: float = 1 / 255,
        alpha_max: float = 0.99,
        transmittance_min: float = 1e-4,
        compensation_min: float = 0.005,
    ) -> Tuple[_Floats, _Floats, Dict[str, Any], Tape]: ...
    def save(self, path: Union[str, PathLike[str]]) -> List[str]: ...
    def __len__(self) -> int: ...

class Tape:
    def backward(self, v_colors: _Floats, v_alphas: Optional[_Floats] = None) -> _Gradients: ...
