"""What engines report of the dynamics of trees, without a motion, compared with exact values."""
