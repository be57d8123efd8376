"""How what recast ships was made: small models and planners, their data, pictures of the docs.

It is tested and installed for development, and not released. The core never imports it.
"""

PAGES = {
    "recast_tools.planner_training": "docs/planners.md",
    "recast_tools.small_model": "docs/recar.md",
}
"""Page of recast's documentation by module or package, for errors that they raise."""
