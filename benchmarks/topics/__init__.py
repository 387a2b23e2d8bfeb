"""What is measured, one topic a file: each hands back figures, some with the points behind them."""
