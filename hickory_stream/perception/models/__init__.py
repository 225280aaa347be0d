"""The paper's networks (FastSAM, DINOv2, OneFormer) through onnxruntime, and the folder with their files."""
