"""Who does many jobs: this process, several of this machine, or a Ray cluster."""

from recast.crews.crew import Crew, alone, in_processes
from recast.crews.ray_cluster import crew_of, on_ray

__all__ = ["Crew", "alone", "crew_of", "in_processes", "on_ray"]
