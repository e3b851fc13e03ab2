"""Recordings that came with a published benchmark or paper: origin, checksums, licence."""

from __future__ import annotations

from jaxsr.datasets.dataset import Dataset, SourceFile

_TANKS_EMPS_REPOSITORY = "forgi86/sysid-neural-continuous"
_TANKS_EMPS_COMMIT = "956aa7ecd73061b0321c6f6098d74c9e4a7ce67a"

_EMPS = Dataset(
    name="emps",
    title="Electro-mechanical positioning system: prismatic drive, closed loop, 1 kHz",
    repository=_TANKS_EMPS_REPOSITORY,
    commit=_TANKS_EMPS_COMMIT,
    sources=(
        SourceFile(
            "DATA_EMPS.mat",
            "examples/EMPS/data/DATA_EMPS.mat",
            "6cf6814ae14618795da0101aae2bb97ff0c6351b0501b5492751b02b07facf7e",
        ),
        SourceFile(
            "DATA_EMPS_PULSES.mat",
            "examples/EMPS/data/DATA_EMPS_PULSES.mat",
            "0eab75bb1f6b16228ee78791343a88bf9bfd9a51036ac9807d7b5fc11c0e1704",
        ),
        SourceFile(
            "UPSTREAM_README.txt",
            "examples/EMPS/data/README.txt",
            "94796cb148e1a2f5c7cd951b08c6d4a5a0c9f6c7168521004ef99435b49192f6",
            notice="README_emps.txt",
        ),
    ),
    model="emps.toml",
    licence="Apache-2.0 (carrying repository); the benchmark asks for citation",
    citation=(
        "Janot, Gautier, Brunot: Data Set and Reference Models of EMPS, "
        "Workshop on Nonlinear System Identification Benchmarks, 2019"
    ),
    left_out="Coulomb friction and a constant offset, then friction that differs by direction",
)

_UR10E = Dataset(
    name="ur10e",
    title="UR10e six-axis arm: joint motion and motor currents, 100 Hz",
    repository="shamilmamedov/dynamic_calibration",
    commit="11af40e7deb758ec080a175fed8fcdd6c99aca29",
    sources=(
        SourceFile(
            "ident_30sec_12harm.csv",
            "dataset_ur10e/identification_data/ur-20_02_10-30sec_12harm.csv",
            "341fff80f177be564c8720ea898165addfd46d7cbe6f3ffd8923eeaae0eef000",
        ),
        SourceFile(
            "unloaded_14harm50sec.csv",
            "dataset_ur10e/identification_data/ur-20_02_19_14harm50sec.csv",
            "cd503afc985c41a6ad8fbe47d443c961eadbde4822a87ff3e17adcb2a24fa103",
        ),
        SourceFile(
            "validation_ptp_10_points.csv",
            "dataset_ur10e/validation_data/ur-20_01_17-ptp_10_points.csv",
            "d97a4ac0c8b892b565d12f33af2bf0ef18183f7742e49d847d8ba92a041b56d8",
        ),
        SourceFile(
            "ur10e.urdf",
            "URe/urdf/ur10e.urdf",
            "0d2abc6ebc70725c691a35aa6c2d03fd6e8158017a1b7da7a10a3ef52de7b821",
        ),
    ),
    model="ur10e_joint1.toml",
    licence="none stated: for evaluation only, not to be redistributed",
    citation="Mamedov: dynamic_calibration, github.com/shamilmamedov/dynamic_calibration",
    left_out="Coulomb and viscous friction in the joints",
)

_DFKI = Dataset(
    name="dfki_pendulum",
    title="Torque-controlled pendulum with a quasi-direct drive, 200 to 500 Hz",
    repository="dfki-ric-underactuated-lab/torque_limited_simple_pendulum",
    commit="ed17ea2d32a35ad944944ca03ef57693e2986732",
    sources=(
        SourceFile(
            "simple/ddp_measured.csv",
            "results/video_recorded_ddp/data_measured.csv",
            "14748fd189abae7b6392a016f2f0494b54bb2a8c014bc435a84b58dbecb2da35",
            commit="c761de7813573a6674ebd94afb66b83e44ea9148",
        ),
        SourceFile(
            "simple/energy_shaping_measured.csv",
            "results/video_recorded_energy_shaping/data_measured.csv",
            "e1844e56f87cf763bdecb3f6f7e5b622a9a3b2d71e907b48ed6148b0a059c209",
            commit="c761de7813573a6674ebd94afb66b83e44ea9148",
        ),
        SourceFile(
            "simple/energy_shaping_1kg_measured.csv",
            "results/video_recorded_energy_shaping_1kg/data_measured.csv",
            "61d782d4797500fb2e7f42b4ad80c8c694e5e5ebdf5862535acb94a475b950d2",
            commit="86d96d01ac3471d34b49910c912d2360c1f8ced6",
        ),
        SourceFile(
            "simple/sysid_measured.csv",
            "results/20210611-040141-PM_pd/data_measured.csv",
            "3a5728e9c5530dd9066c0d7fda4c6a9bf50d86f94538629ace6d2508a7053469",
            commit="86d96d01ac3471d34b49910c912d2360c1f8ced6",
        ),
    ),
    model="dfki_pendulum.toml",
    licence="BSD-3-Clause",
    citation=(
        "Wiebe et al.: Torque-limited simple pendulum, Journal of Open Source Software, 2022, "
        "doi 10.21105/joss.03884"
    ),
    left_out="Coulomb and viscous friction, a torque offset, backlash and lag of the drive",
)

_SILVERBOX = Dataset(
    name="silverbox",
    title="Silverbox: circuit that imitates a mass on a hardening spring, 610 Hz",
    repository="biaslab/nsi-silverbox",
    commit="728f07e4539d4f7da76a4778b52a756260b488ac",
    sources=(
        SourceFile(
            "SNLS80mV.mat",
            "data/Silverbox/SNLS80mV.mat",
            "5c7413a52255af0cb4e2f93fb6903beb92b08965ba1e6ad0a6ffedfed8477ed4",
        ),
        SourceFile(
            "Schroeder80mV.mat",
            "data/Silverbox/Schroeder80mV.mat",
            "ec5a9740a4789aa20b9d84f387424c0218e843844807b30b367c218778339fb6",
        ),
    ),
    model="silverbox.toml",
    licence="MIT (carrying repository); the benchmark asks for citation",
    citation=(
        "Wigren, Schoukens: Three free data sets for development and benchmarking in nonlinear "
        "system identification, European Control Conference, 2013"
    ),
    left_out="the cubic stiffness, and a small offset",
)

_TANKS = Dataset(
    name="cascaded_tanks",
    title="Two cascaded tanks, the upper level unmeasured, sampled every 4 s",
    repository=_TANKS_EMPS_REPOSITORY,
    commit=_TANKS_EMPS_COMMIT,
    sources=(
        SourceFile(
            "dataBenchmark.csv",
            "examples/CTS/data/dataBenchmark.csv",
            "ef2388ed822f3aef4aa80d6b0f2b466dd80b361786b3eafc7a2957c31ea323a7",
        ),
    ),
    model="cascaded_tanks.toml",
    licence="Apache-2.0 (carrying repository); the benchmark asks for citation",
    citation=(
        "Schoukens, Noel: Three benchmarks addressing open challenges in nonlinear system "
        "identification, IFAC World Congress, 2017"
    ),
    left_out="overflow of the upper tank, part of it into the lower one, and saturated levels",
)

_BALLS = Dataset(
    name="falling_balls",
    title="Eleven balls dropped from about 47 m, two drops each, filmed at 15 Hz",
    repository="briandesilva/discovery-of-physics-from-data",
    commit="b79c34317f049c9b47aaf2cc4c54c5ec7219f3d7",
    sources=(
        SourceFile(
            "Ball_drops_data.xls",
            "data/Ball_drops_data.xls",
            "942b2d68abfff3828ca323de491435d4ec27c3a22e62cee0cbdf52c2e8d1c0ed",
        ),
        SourceFile(
            "balls.txt",
            "data/balls.txt",
            "7cc282a6559ef636ce30cad53aae5bf825ce6200a94dd54f668af9797c584585",
            notice="balls.txt",
        ),
        SourceFile(
            "UPSTREAM_LICENSE",
            "LICENSE",
            "0f6365e90cb707c44d4eaa4fcf64ad3589925f9a3bc0b4212a03da49c0a406a7",
            notice="LICENSE_falling_balls.txt",
        ),
    ),
    model="balls.toml",
    licence="MIT",
    citation=(
        "de Silva, Higdon, Brunton, Kutz: Discovery of Physics From Data: Universal Laws and "
        "Discrepancies, Frontiers in Artificial Intelligence, 2020"
    ),
    left_out="air drag on the light balls; nothing that these data show on the dense ones",
)

ENTRIES = (_EMPS, _UR10E, _DFKI, _SILVERBOX, _TANKS, _BALLS)
