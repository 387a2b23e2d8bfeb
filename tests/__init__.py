"""The tests are a package, because an installed package `tests` would take precedence over a plain folder."""
