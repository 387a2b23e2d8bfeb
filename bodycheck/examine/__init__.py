"""Why a motion is wrong: probes, laws and known maps, the diagnosis, and what engines report of trees."""
