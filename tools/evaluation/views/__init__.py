"""The paper's experiment on views: each object reconstructed from the one view that each strategy would choose."""
