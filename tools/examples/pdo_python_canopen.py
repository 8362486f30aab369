#!/usr/bin/python3
"""Sets the lever arm of a gateway and prints what its PDOs say, with python-canopen (pip install canopen).

    pdo_python_canopen.py --interface socketcan --channel can0 --node 5
    pdo_python_canopen.py --interface udp_multicast --channel 239.74.163.2      # a gateway with --can udp
"""
import argparse
import pathlib
import queue

import canopen

EDS = pathlib.Path(__file__).resolve().parents[2] / "eds/imu9-gateway.eds"
COUNTER = "Sample.Sample counter"
LEVER_ARM_M = {"l": 0.05, "s": -0.02, "t": 0.1}  # from the reference point to the accelerometer

parser = argparse.ArgumentParser()
parser.add_argument("--interface", default="socketcan", help="of python-can")
parser.add_argument("--channel", default="can0")
parser.add_argument("--node", type=int, default=5)
parser.add_argument("--eds", default=EDS, help="the gateway hands it out, too: imu9-sdo read eds -o FILE")
parser.add_argument("--samples", type=int, help="end after so many, default: Ctrl-C")
options = parser.parse_args()

network = canopen.Network()
network.connect(interface=options.interface, channel=options.channel)
node = network.add_node(options.node, str(options.eds))

for axis, metres in LEVER_ARM_M.items():
    node.sdo["Lever arm"]["Lever arm " + axis].raw = metres

# one step of the integer values in a PDO, which the gateway's configuration decides
step = {
    "Acceleration": (node.sdo["Resolution"]["Resolution acceleration"].raw / 1000, "m/s^2"),
    "Angles": (node.sdo["Angle resolution"].raw / 1000, "deg"),
    "Position output": (node.sdo["Resolution"]["Resolution position"].raw / 1000, "m"),
}


def text(variable):
    record, name = variable.name.split(".")  # python-canopen puts the name of the record before that of the sub-index
    factor, unit = step.get(record, (1, ""))
    return "%s = %.10g %s" % (name, variable.raw * factor, unit)


node.tpdo.read()  # COB-IDs and mapping as the node has them now
pdos = [pdo for pdo in node.tpdo.values() if pdo.enabled]
samples = queue.Queue()


def last_pdo_received(_):
    """Called by the thread that receives, so the other PDOs do not change meanwhile."""
    counters = {pdo[COUNTER].raw for pdo in pdos}
    if len(counters) == 1:  # all of one sample
        samples.put([text(variable).strip() for pdo in pdos for variable in pdo if variable.name != COUNTER])


pdos[-1].add_callback(last_pdo_received)
node.nmt.state = "OPERATIONAL"
network.sync.start(0.1)  # the default transmission type: each SYNC is answered by all PDOs
try:
    received = 0
    while received != options.samples:
        print(", ".join(samples.get(timeout=2)), flush=True)
        received += 1
except queue.Empty:
    raise SystemExit("no PDOs within 2 s: TPDO1 to TPDO4 must be enabled and answer each SYNC (transmission type 1)")
except KeyboardInterrupt:
    pass
finally:
    network.sync.stop()
    network.disconnect()
