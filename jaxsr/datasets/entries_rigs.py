"""Recordings of test rigs and robots that their owners keep beside code: origin, checksums.

Where `SourceFile.raw` is given, the origin holds the values in a form of its own, and the checksum
is that of the table which this package makes of them.
"""

from __future__ import annotations

from jaxsr.datasets.dataset import Dataset, SourceFile

_BAM_RUNS = (
    (
        "kp100_sin_sin.csv",
        "2026-01-15_10h28m10.json",
        "107b4f4a8d489e53e452f9581c7a2c133064ccbe65b3fa6366c2f66b097515b5",
    ),
    (
        "kp100_lift_and_drop.csv",
        "2026-01-15_10h28m17.json",
        "4671b6c65154d7f2573ea24f1a300657a698c722a1c80eab9cdc64d98e27f97a",
    ),
    (
        "kp100_up_and_down.csv",
        "2026-01-15_10h28m24.json",
        "56720223ed4f7e13c59052cf40da3475b4a525cf31d39b016c597ffcfbc16ce8",
    ),
    (
        "kp100_sin_time_square.csv",
        "2026-01-15_10h28m32.json",
        "232c4758c067e0dcaad3ebef3d525fce96765845d069a6a04674d0c6a82c3390",
    ),
    (
        "kp200_sin_sin.csv",
        "2026-01-15_10h28m42.json",
        "f5e90fd05f037406e50d4367561f4195cccc0ef84721f093221c3da19e362dd4",
    ),
    (
        "kp200_lift_and_drop.csv",
        "2026-01-15_10h28m49.json",
        "2e52ce77f1ff286705548cfcb295e4f2e7914aec60d61848adebf7b41d019376",
    ),
    (
        "kp200_up_and_down.csv",
        "2026-01-15_10h28m57.json",
        "ef9f6e4c79a0b4aac3cad8e11347e0c77873c8930dd9df28323036108468403e",
    ),
    (
        "kp200_sin_time_square.csv",
        "2026-01-15_10h29m04.json",
        "9ab1bae3958daa7f7c4f6f520e12a5cbb66d4035ac8f23f510ebd39343891ba3",
    ),
    (
        "kp400_sin_sin.csv",
        "2026-01-15_10h29m14.json",
        "0d33236203bfb6403191faa304fa36eba55fa6915be59111b21aaf4582674a40",
    ),
    (
        "kp400_lift_and_drop.csv",
        "2026-01-15_10h29m21.json",
        "20d803df99502f56b75ca462c8e84ce07f90bb1cd2d4e3d22a235c0d2a70aec5",
    ),
    (
        "kp400_up_and_down.csv",
        "2026-01-15_10h29m29.json",
        "5ddcaa796f5a0f092e54b7b0781da85f8d372f9f622961113ac03a2dfff20e85",
    ),
    (
        "kp400_sin_time_square.csv",
        "2026-01-15_10h29m37.json",
        "9fa1b8f661e78fc834724fb74d71e006e6eb0018291166fa7abdf98f91d199b0",
    ),
    (
        "kp800_sin_sin.csv",
        "2026-01-15_10h29m47.json",
        "661536473eff8c6dffcf4375ffc497c7ba12f812c05dcd7673a543af637d4a52",
    ),
    (
        "kp800_lift_and_drop.csv",
        "2026-01-15_10h29m54.json",
        "68ceaebcae370d510b901b69423f4aa984aa82b5f1c40f31bb1b274a2583524d",
    ),
    (
        "kp800_up_and_down.csv",
        "2026-01-15_10h30m02.json",
        "70c325c4806f738b5603ccfc02b7751bca2a80e06708369de669b77222e8a5f3",
    ),
    (
        "kp800_sin_time_square.csv",
        "2026-01-15_10h30m10.json",
        "3b271e7ecc7b1e29b31d346393c9e85cf421a022d6673c308a5b67233a892678",
    ),
)

_BAM = Dataset(
    name="bam_xl330",
    title="Dynamixel XL330 servo lifting a pendulum: 16 runs at four gains, about 200 Hz",
    repository="Rhoban/bam",
    commit="af2260462471ff45ac18af159b1327ea51d8db15",
    sources=tuple(
        SourceFile(path, "", sha256, raw=(f"bam/data.bak/raw/{upstream}",))
        for path, upstream, sha256 in _BAM_RUNS
    ),
    model="bam_xl330.toml",
    further=("bam_xl330_frictionless.toml",),
    licence="Apache-2.0",
    citation=(
        "Duclusaud, Passault et al.: Extended Friction Models for the Physics Simulation of "
        "Servo Actuators, ICRA 2025, arXiv 2410.08650"
    ),
    left_out="friction that grows with the load; in the frictionless model Coulomb friction too",
)

_CED = Dataset(
    name="ced",
    title="Coupled electric drives: two motors, a belt and a pulley on a spring, 50 Hz",
    repository="RomanFoell/DRGP-VSS",
    commit="457f35ffd321cdfe9359d1df707fde9a32041c9c",
    sources=(
        SourceFile(
            "drive.mat",
            "matlab/data_raw/drive.mat",
            "47d0825678d854d8a1bbcfb0ad1188026b853f69beb2067ea00cfd88d13dc4ca",
        ),
    ),
    model="ced.toml",
    licence="MIT (carrying repository); free for benchmarking",
    citation=(
        "Wigren, Schoukens: Coupled electric drives data set and reference models, "
        "Uppsala University, 2017-024"
    ),
    left_out="the sensor reads the absolute speed; dead zone or dry friction of the drive",
)

_GO2 = Dataset(
    name="go2",
    title="Unitree Go2 quadruped, base held: twelve position servos, 200 Hz",
    repository="iit-DLSLab/sim2real-robot-identification",
    commit="06739ea",
    sources=(
        SourceFile(
            "traj_0.csv",
            "datasets/go2/traj_0.pt",
            "7aca2f4eb30480d323748376491d4befa93e50348a3c899a714d684966008383",
            by_hand="the origin keeps it as a pickled PyTorch file, which is never opened",
        ),
        SourceFile(
            "go2.xml",
            "robot_model/go2/go2.xml",
            "e66b59d1096b5b2004b6bc36bfcfc35480cd1e0c92ec68fc896ef8c0661e5b71",
            notice="robot.xml",
        ),
    ),
    model="",
    licence="BSD-3-Clause",
    citation=(
        "Dynamic Legged Systems lab: sim2real-robot-identification, "
        "github.com/iit-DLSLab/sim2real-robot-identification"
    ),
    left_out="damping is given far too high, friction and armature of the calf too low",
)

_KVLCC2 = Dataset(
    name="kvlcc2",
    title="KVLCC2 ship model, 1:68: three roll decays in a towing tank, 50 Hz",
    repository=(
        "martinlarsalbert/"
        "Prediction-of-roll-motion-using-fully-nonlinear-potential-flow-and-Ikedas-method"
    ),
    commit="cce8abde16a15a2ae45008e48b1bba9f4aeaaad4",
    sources=(
        SourceFile(
            "roll_21337.csv",
            "",
            "d032a5b6140527628d7417941c8608f5784c8b6d4ad31a9c19e5706179d85f3a",
            raw=("data/processed/roll decay KVLCC2/model_test_21337.csv",),
        ),
        SourceFile(
            "roll_21338.csv",
            "",
            "a3e30ef666603aee692d6c229387d40c702982e06312666fda79054be36a20fd",
            raw=("data/processed/roll decay KVLCC2/model_test_21338.csv",),
        ),
        SourceFile(
            "roll_21340.csv",
            "",
            "21e685a8758e02772e99336db9858ae82817611e46d34b51f2b7968571e984ca",
            raw=("data/processed/roll decay KVLCC2/model_test_21340.csv",),
        ),
    ),
    model="kvlcc2.toml",
    licence="MIT",
    citation=(
        "Alexandersson et al.: Prediction of roll motion using fully nonlinear potential flow "
        "and Ikeda's method; data doi 10.17632/2stvkyngj9.1"
    ),
    left_out="quadratic damping and a restoring moment that hardens",
)

_PENDULA = Dataset(
    name="multiarm_pendulum",
    title="Single, double and triple pendulum, free swings, encoders at 500 Hz",
    repository="dynamicslab/MultiArm-Pendulum",
    commit="e99a7e13fe2adc8fc647321a156b6cb59a48a698",
    sources=(
        SourceFile(
            "single_id.csv",
            "",
            "2ee3a3f34047105158a3391a495637d4066ea668e35c1c8b7870a19f5b7c6b7c",
            raw=(
                "ParameterEstimation/SinglePendulum/SinglePendulumDataForParameterEstimation.mat",
            ),
        ),
        SourceFile(
            "single_vad.csv",
            "",
            "d5146529271d79f8c674180174c67b5126b869d0795f19cf5dbc6bf7c0f66564",
            raw=(
                "ParameterEstimation/SinglePendulum/SinglePendulumDataForParameterEstimation.mat",
            ),
        ),
        SourceFile(
            "double_id.csv",
            "",
            "de0544fdaf36d8166336f3908ac6bd2b17bc2692a4022d24c9349713b6b44ce4",
            raw=(
                "ParameterEstimation/DoublePendulum/DoublePendulumDataForParameterEstimation.mat",
            ),
        ),
        SourceFile(
            "double_vad.csv",
            "",
            "6313a19ab7598a014ae4bd723e7b55e5c952320322367a4318ded8f1c7fe7af9",
            raw=(
                "ParameterEstimation/DoublePendulum/DoublePendulumDataForParameterEstimation.mat",
            ),
        ),
        SourceFile(
            "triple_id.csv",
            "",
            "9109da4c73e19b50c9102afbe586115a9eb316d9ed8029132a4e837901218943",
            raw=(
                "ParameterEstimation/TriplePendulum/TriplePendulumDataForParameterEstimation.mat",
            ),
        ),
        SourceFile(
            "triple_vad.csv",
            "",
            "3ea3052f42429dd38b761451935a91deb0e1d5acc98c8cef0cd20ec136460160",
            raw=(
                "ParameterEstimation/TriplePendulum/TriplePendulumDataForParameterEstimation.mat",
            ),
        ),
    ),
    model="multiarm_pendulum.toml",
    further=("double_pendulum.toml", "triple_pendulum.toml"),
    licence="MIT",
    citation=(
        "Kaheman, Fasel, Bramburger, Strom, Kutz, Brunton: The Experimental Multi-Arm Pendulum "
        "on a Cart, arXiv 2205.06231"
    ),
    left_out="dry friction and air drag, where the owners have viscous friction",
)

_TX40 = Dataset(
    name="tx40",
    title="Staubli TX40 six-axis arm: joint angles and joint torques, 1 kHz",
    repository="thanhndv212/figaroh-examples",
    commit="c0b5c7f0fda10078be55104f9ee76ac106b7a5ee",
    sources=(
        SourceFile(
            "tx40_1khz.csv",
            "",
            "02aaa9c621167d67a83631802f68fc65b046aff55a08f6c5efffeae313837f5f",
            raw=(
                "examples/staubli_TX40/data/pos_read_data.csv",
                "examples/staubli_TX40/data/curr_data.csv",
            ),
        ),
        SourceFile(
            "tx40_mdh_modified.urdf",
            "examples/staubli_TX40/urdf/tx40_mdh_modified.urdf",
            "3d00cbd46279c915d594b1bb4610dbac78d1e99ed27f95de70984bde13486074",
        ),
    ),
    model="",
    licence="Apache-2.0 (stated in the files' headers)",
    citation="Nguyen et al.: FIGAROH, github.com/thanhndv212/figaroh-plus",
    left_out="Coulomb and viscous friction, in the wrist on a sum of two speeds; rotor inertia",
)

ENTRIES = (_BAM, _CED, _GO2, _KVLCC2, _PENDULA, _TX40)
