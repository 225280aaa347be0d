"""The network in torch: a small U-Net whose every layer has an exact form in eight bits."""
# Encoder and decoder of Ronneberger et al. 2015 with skips, output at half the input's size; affinities to neighbours
# at growing distances as in Wolf et al. 2018 and Lee et al. 2017. Only convolutions with a ReLU, nearest enlargement
# and concatenation: in eight bits the first is integers and one rounding, the others are copies (`export.py`).

from itertools import pairwise

import torch
from torch import nn

from hickory_stream.perception.affinity.pixel_inputs import NUM_INPUTS, UNIT, ZERO
from hickory_stream.perception.affinity.pixel_network import NUM_OUTPUTS

WIDTHS = (24, 48, 64, 96, 128)
DECODED = (32, 32, 64, 96)


class Layer(nn.Module):
    """A convolution of 3x3 pixels, batch normalisation, ReLU."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False)
        self.norm = nn.BatchNorm2d(outputs)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.relu(self.norm(self.conv(x)))


class AffinityNet(nn.Module):
    """From (B, NUM_INPUTS, H, W) inputs to (B, NUM_OUTPUTS, H / 2, W / 2) log-odds; H and W multiples of 32."""

    def __init__(self) -> None:
        super().__init__()
        sizes = (NUM_INPUTS, *WIDTHS)
        self.down = nn.ModuleList(Layer(a, b, stride=2) for a, b in pairwise(sizes))
        self.same = nn.ModuleList(Layer(n, n) for n in WIDTHS)
        above = (*DECODED[1:], WIDTHS[-1])
        self.up = nn.ModuleList(
            Layer(below + skip, out) for below, skip, out in zip(above, WIDTHS[:-1], DECODED, strict=True)
        )
        self.head = nn.Conv2d(DECODED[0], NUM_OUTPUTS, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        kept = []
        for down, same in zip(self.down, self.same, strict=True):
            x = same(down(x))
            kept.append(x)
        for i in reversed(range(len(self.up))):
            x = nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")
            x = self.up[i](torch.cat([x, kept[i]], dim=1))
        logits: torch.Tensor = self.head(x)
        return logits


def inputs_of(inputs: torch.Tensor) -> torch.Tensor:
    """Return (B, NUM_INPUTS, H, W) bytes as the network takes them."""
    values = (inputs.float() - ZERO) / UNIT
    return values.contiguous(memory_format=torch.channels_last)
