"""Three robots map a small building; the report lands in the folder `report`."""

from station.api import Scenario, run

result = run(Scenario(map="rooms-small", seed=1), out="report")
print(f"{result.metrics.exit_reason} after {result.metrics.sim_s:.1f} s")
print(f"covered {result.metrics.coverage:.1%}, error {result.metrics.team.ate_rmse_m:.3f} m")
