"""Training: what counts in the loss, what a batch is, and that a run may end and go on."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grasping.lab.training.trainer import (
    MapTargets,
    NetworkTrainer,
    NetworkTraining,
    batch,
    images,
    losses,
    random_batch,
)

SMALL = NetworkTraining(steps=40, count=2, side=60, rate=3e-3, warm_up=5, half=False)


def some_arrays(count=4, side=120, seed=0):
    """Samples of bars, to be grasped across."""
    rng = np.random.default_rng(seed)
    shape = (count, side, side)
    samples = {
        "depth": np.zeros(shape, np.float16),
        "quality": np.zeros(shape, np.uint8),
        "angle": rng.integers(0, 256, shape).astype(np.uint8),
        "width": np.zeros(shape, np.uint8),
        "known": np.ones(shape, bool),
    }
    for i in range(count):
        row, column = rng.integers(10, side - 50, 2)
        bar = (i, slice(row, row + 14), slice(column, column + 40))
        samples["depth"][bar], samples["quality"][bar], samples["width"][bar] = -0.04, 200, 40
        samples["angle"][bar] = 128
    return samples


def some_images(**kind):
    return images(some_arrays(**kind))


def maps_of(target: MapTargets) -> torch.Tensor:
    return torch.stack([target.quality, target.cos, target.sin, target.width], dim=1)


def test_background_teaches_no_angle_and_no_width():
    _, target = batch(some_images().arrays)
    maps = maps_of(target)
    background = target.quality == 0.0
    for channel in (1, 2, 3):
        maps[:, channel][background] = 7.0
    assert float(losses(maps, target).total) == pytest.approx(0.0, abs=1e-9)
    maps[:, 0][background] = 1.0
    assert float(losses(maps, target).quality) > 0.5


def test_unknown_pixels_do_not_count():
    samples = some_arrays()
    samples["known"][:, :60] = False
    _, target = batch(images(samples).arrays)
    maps = maps_of(target)
    maps[:, :, :60] = 9.0
    assert float(losses(maps, target).total) == pytest.approx(0.0, abs=1e-9)


def test_batches_depend_on_the_seed_alone():
    samples = some_images()
    for a, b in zip(*(random_batch(samples, np.random.default_rng(8), 3, 96) for _ in range(2))):
        for x, y in zip(a, b) if isinstance(a, MapTargets) else [(a, b)]:
            assert torch.equal(x, y)


def test_mirrors_turn_the_angle():
    """A field of one angle stays so or becomes its negative."""
    bars = some_arrays(1)
    bars["angle"][:] = 32  # 22.5 degrees
    samples = images(bars)
    signs = set()
    for seed in range(40):
        _, target = random_batch(samples, np.random.default_rng(seed), 1, 60)
        assert torch.allclose(target.cos, torch.tensor(0.70710678))
        signs.add(round(float(target.sin.mean()), 4))
    assert signs == {0.7071, -0.7071}


def test_windows_are_cut_from_the_images_mirrored_or_not():
    """Each pixel's five values stay together: they are those of one pixel of one image, in order or in reverse."""
    rng, shape = np.random.default_rng(3), (3, 70, 80)
    bars = some_arrays()
    bars = {name: rng.integers(0, 200, shape).astype(values.dtype) for name, values in bars.items()}
    bars["known"][:] = True
    bars["quality"][:] = np.arange(np.prod(shape)).reshape(shape) % 251
    _, target = random_batch(images(bars), np.random.default_rng(1), 20, 60)
    width = np.round(255.0 * target.width.numpy()).astype(int)
    found = set()
    for one in width:
        matches = [
            (i, row, column, flips)
            for i in range(3)
            for flips in ((1, 1), (-1, 1), (1, -1), (-1, -1))
            for row in range(11)
            for column in range(21)
            if (bars["width"][i, row : row + 60, column : column + 60][:: flips[0], :: flips[1]] == one).all()
        ]
        assert len(matches) == 1
        found |= {flips for *_, flips in matches}
    assert len(found) == 4


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_cuda_device_trains_as_the_processor_does():
    arrays = some_arrays()
    device = torch.device("cuda")
    here, there = NetworkTrainer(SMALL), NetworkTrainer(SMALL, device)
    for _ in range(3):
        assert there.train(images(arrays, device)) == pytest.approx(here.train(images(arrays)), rel=1e-3)
    found, wanted = there.validate(images(arrays, device)), here.validate(images(arrays))
    assert found == pytest.approx(wanted, rel=0.02)


def test_a_run_may_end_and_go_on(tmp_path):
    samples = some_images()
    whole = NetworkTrainer(SMALL)
    for _ in range(6):
        whole.train(samples)
    first = NetworkTrainer(SMALL)
    for _ in range(3):
        first.train(samples)
    torch.save(first.state(), tmp_path / "state.pt")
    second = NetworkTrainer(SMALL)
    second.resume(torch.load(tmp_path / "state.pt", weights_only=True))
    for _ in range(3):
        second.train(samples)
    assert second.step == whole.step == 6
    for a, b in zip(whole.mean.parameters(), second.mean.parameters()):
        torch.testing.assert_close(a, b, rtol=0.0, atol=0.0)


def test_training_learns():
    samples = some_images()
    trainer = NetworkTrainer(SMALL)
    before = trainer.validate(samples)["validation"]
    found = [trainer.train(samples) for _ in range(SMALL.steps)]
    assert np.mean(found[-5:]) < 0.7 * np.mean(found[:5])
    assert trainer.validate(samples)["validation"] < before


def test_rate_warms_up_and_ends_at_zero():
    trainer = NetworkTrainer(NetworkTraining(steps=1000, rate=1e-3, warm_up=100, decay=0.2))
    rates = []
    for trainer.step in range(1001):
        rates.append(trainer.rate())
    assert rates[0] == pytest.approx(1e-5)
    assert rates[100:800] == pytest.approx([1e-3] * 700)
    assert rates[900] == pytest.approx(5e-4)
    assert rates[1000] == 0.0
