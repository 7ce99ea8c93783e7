"""Label denoising: positions to train on, estimated from labels, predictions and images."""
