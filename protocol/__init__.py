"""What crosses the wire between the world, the robots and the station, and nothing else.

Importing this package also fixes the process environment on which identical results depend
(see `protocol.environment`); it therefore comes before numpy in every package of the project.
"""

from protocol.environment import prepare_environment

prepare_environment()
