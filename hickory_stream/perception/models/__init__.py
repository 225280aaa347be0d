"""The paper's networks through onnxruntime: FastSAM, DINOv2, OneFormer, and what their files are known by."""
