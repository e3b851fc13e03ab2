"""Files of test benches and robots: HDF5, TDMS, MDF4, MCAP, ROS bags, by libraries of others.

`opened` reads a file in a process of its own, `merged` lays channels with clocks of their own on
one time. `child` is that process; `hdf5`, `tdms`, `mdf4`, `mcap_file`, `bag` and `messages` belong
to it and import nothing of the package.
"""
