"""The names of the public API and where each is."""

from .core.articulated_object import (
    Affordance,
    ArticulatedObject,
    Part,
    Prediction,
    SegmentedObject,
)
from .core.asset import Asset
from .core.errors import ArtiworldError
from .core.geometry import Mesh, PointCloud
from .core.joint import Joint
from .core.progress import no_progress
from .core.tree import KinematicTree
from .data.registry import DatasetOptions, GroundTruth, open_dataset
from .geometry.prepare import Prepared, PrepareSettings, prepare
from .geometry.splitting import split
from .io.assets.asset_folder import write_asset
from .io.assets.reader import load_object
from .io.export.registry import export, exporter_names, load_exporter
from .io.masks import Masks, read_masks, with_masks
from .io.open_asset import open_asset, read_part_files
from .prediction.registry import load_predictor, predictor_names
from .scenes.registry import read_scene
from .segmentation.prompts import Click, PartSegmentation, Prompts, Region
from .segmentation.registry import load_segmenter, segmenter_names
from .validation.runner import validate

__all__ = [
    "Affordance",
    "ArticulatedObject",
    "ArtiworldError",
    "Asset",
    "Click",
    "DatasetOptions",
    "GroundTruth",
    "Joint",
    "KinematicTree",
    "Masks",
    "Mesh",
    "Part",
    "PartSegmentation",
    "PointCloud",
    "Prediction",
    "PrepareSettings",
    "Prepared",
    "Prompts",
    "Region",
    "SegmentedObject",
    "export",
    "exporter_names",
    "load_exporter",
    "load_object",
    "load_predictor",
    "load_segmenter",
    "no_progress",
    "open_asset",
    "open_dataset",
    "predictor_names",
    "prepare",
    "read_masks",
    "read_part_files",
    "read_scene",
    "segmenter_names",
    "split",
    "validate",
    "with_masks",
    "write_asset",
]
