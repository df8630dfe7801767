"""Point-BERT: grouping, published names and shapes, the small variant."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra network")

from model.prediction.arti4urdf.point_bert import (  # noqa: E402
    NANO,
    ULIP2,
    PointBert,
    PointBertConfig,
    Projector,
    farthest_points,
    group_points,
)

TINY = PointBertConfig(
    width=24, depth=2, heads=3, groups=12, neighbours=8, encoder_width=20, point_width=8
)


@pytest.fixture
def cloud():
    points = np.random.default_rng(0).uniform(-1, 1, (3, 150, 6)).astype(np.float32)
    return torch.from_numpy(points)


def published_shapes(depth: int) -> dict[str, tuple[int, ...]]:
    """Parameters of ULIP-2's Point-BERT as its checkpoint lists them, prefix removed."""
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("cls_token", "cls_pos"), (1, 1, 384))
    shapes |= {"reduce_dim.weight": (384, 256), "reduce_dim.bias": (384,)}
    shapes |= {"pos_embed.0.weight": (128, 3), "pos_embed.0.bias": (128,)}
    shapes |= {"pos_embed.2.weight": (384, 128), "pos_embed.2.bias": (384,)}
    shapes |= {"norm.weight": (384,), "norm.bias": (384,)}
    for conv, (first, middle, last) in {
        "first_conv": (6, 128, 256),
        "second_conv": (512, 512, 256),
    }.items():
        shapes[f"encoder.{conv}.0.weight"] = (middle, first, 1)
        shapes[f"encoder.{conv}.0.bias"] = (middle,)
        for name in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"encoder.{conv}.1.{name}"] = (middle,)
        shapes[f"encoder.{conv}.1.num_batches_tracked"] = ()
        shapes[f"encoder.{conv}.3.weight"] = (last, middle, 1)
        shapes[f"encoder.{conv}.3.bias"] = (last,)
    for index in range(depth):
        block = f"blocks.blocks.{index}"
        for norm in ("norm1", "norm2"):
            shapes |= {f"{block}.{norm}.weight": (384,), f"{block}.{norm}.bias": (384,)}
        shapes[f"{block}.attn.qkv.weight"] = (1152, 384)
        for layer, (inside, out) in {
            "attn.proj": (384, 384),
            "mlp.fc1": (384, 1536),
            "mlp.fc2": (1536, 384),
        }.items():
            shapes[f"{block}.{layer}.weight"] = (out, inside)
            shapes[f"{block}.{layer}.bias"] = (out,)
    return shapes


@pytest.mark.parametrize("config", [ULIP2, replace(ULIP2, depth=12)])
def test_published_state_dict_loads_without_a_missing_key(config):
    weights = {
        name: torch.zeros(shape, dtype=torch.long if "batches" in name else torch.float32)
        for name, shape in published_shapes(config.depth).items()
    }
    with torch.device("meta"):
        model = PointBert(config)
    model.load_state_dict(weights, strict=True, assign=True)


def published_convolutions(layers):
    """The same layers as ``Conv1d`` over (batch, channel, point), as they were published."""
    made = torch.nn.Sequential()
    for layer in layers:
        if hasattr(layer, "in_channels"):
            convolution = torch.nn.Conv1d(layer.in_channels, layer.out_channels, 1)
            convolution.load_state_dict(layer.state_dict())
            made.append(convolution)
        else:
            made.append(layer)
    return made


def published_encoder(model: PointBert, neighbourhoods):
    batch, groups, count, channels = neighbourhoods.shape
    points = neighbourhoods.reshape(batch * groups, count, channels).transpose(2, 1)
    local = published_convolutions(model.encoder.first_conv)(points)
    summary = local.max(2, keepdim=True).values
    both = torch.cat([summary.expand(-1, -1, count), local], dim=1)
    features = published_convolutions(model.encoder.second_conv)(both)
    return features.max(2).values.view(batch, groups, -1)


@pytest.mark.parametrize("training", [False, True])
def test_mini_pointnet_equals_the_convolutions(cloud, training):
    torch.manual_seed(0)
    model = PointBert(TINY).train(training)
    neighbourhoods = group_points(cloud, TINY).neighbourhoods
    ours, theirs = model.encoder(neighbourhoods), published_encoder(model, neighbourhoods)
    torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=0)


def literal_sampler(points: np.ndarray, count: int, skip: bool) -> list[int]:
    """The CUDA sampler's loop, one point after the other."""
    nearest = np.full(len(points), np.inf, np.float32)
    chosen = [0]
    while len(chosen) < count:
        best, best_index = -1.0, 0
        for index, point in enumerate(points):
            if skip and (point**2).sum() <= 1e-3:
                continue
            distance = ((point - points[chosen[-1]]) ** 2).sum()
            nearest[index] = min(nearest[index], distance)
            if nearest[index] > best:
                best, best_index = nearest[index], index
        chosen.append(best_index)
    return chosen


@pytest.mark.parametrize("skip", [False, True])
def test_farthest_points_and_the_cuda_samplers_quirk(cloud, skip):
    xyz = cloud[..., :3].clone()
    xyz[:, 40] = 0.01  # inside the ball that the CUDA sampler leaves out
    chosen = farthest_points(xyz, 150, skip_near_origin=skip)
    for row in range(3):
        assert chosen[row].tolist() == literal_sampler(xyz[row].numpy(), 150, skip)
    assert bool((chosen == 40).any()) != skip


def test_clouds_inside_the_left_out_ball_repeat_their_first_point():
    chosen = farthest_points(torch.full((1, 9, 3), 0.01), 4, skip_near_origin=True)
    assert chosen.tolist() == [[0, 0, 0, 0]]


def test_groups_are_the_nearest_points(cloud):
    groups = group_points(cloud, TINY)
    assert groups.centers.shape == (3, 12, 3)
    assert groups.neighbourhoods.shape == (3, 12, 8, 6)
    tree = cloud[1, :, :3].numpy()
    for group in range(12):
        center = groups.centers[1, group].numpy()
        nearest = np.sort(np.linalg.norm(tree - center, axis=1))[:8]
        found = np.sort(groups.neighbourhoods[1, group, :, :3].norm(dim=-1).numpy())
        np.testing.assert_allclose(found, nearest, atol=1e-6)
    unit = group_points(cloud, replace(TINY, unit_neighbourhoods=True)).neighbourhoods
    torch.testing.assert_close(unit[..., :3].norm(dim=-1).amax(-1), torch.ones(3, 12))
    torch.testing.assert_close(unit[..., 3:], groups.neighbourhoods[..., 3:])


@pytest.mark.parametrize("points", [1, 3, 11])
@pytest.mark.parametrize("config", [TINY, NANO])
def test_fewer_points_than_groups_or_neighbours(cloud, points, config):
    model = PointBert(config).eval()
    few = cloud[:, :points]
    with torch.no_grad():
        feature = model(group_points(few, config))
    assert feature.shape == (3, config.output_width)
    assert torch.isfinite(feature).all()


@torch.no_grad()
def test_order_of_points_matters_only_through_the_first(cloud):
    torch.manual_seed(0)
    model = PointBert(NANO).eval()
    order = torch.cat([torch.zeros(1, dtype=torch.long), 1 + torch.randperm(149)])
    feature = model(group_points(cloud, NANO))
    torch.testing.assert_close(
        model(group_points(cloud[:, order], NANO)), feature, atol=1e-5, rtol=0
    )
    # A batch is as good as one cloud after the other.
    alone = torch.cat([model(group_points(one[None], NANO)) for one in cloud])
    torch.testing.assert_close(alone, feature, atol=1e-5, rtol=0)


def test_feature_is_class_token_and_maximum(cloud):
    torch.manual_seed(0)
    model = PointBert(TINY).eval()
    seen = []
    model.norm.register_forward_hook(lambda module, given, result: seen.append(result))
    feature = model(group_points(cloud, TINY))
    expected = torch.cat([seen[0][:, 0], seen[0][:, 1:].max(1).values], dim=1)
    assert torch.equal(feature, expected)


@pytest.mark.parametrize("config", [TINY, replace(NANO, depth=1)])
def test_every_parameter_learns(cloud, config):
    torch.manual_seed(0)
    model, adapter = PointBert(config), Projector(config.output_width, 32, normalised=True)
    adapter(model(group_points(cloud, config))).square().cumsum(1).sum().backward()
    silent = [
        name
        for part in (model, adapter)
        for name, parameter in part.named_parameters()
        if parameter.grad is None or not parameter.grad.abs().sum() > 0
    ]
    assert silent == []
