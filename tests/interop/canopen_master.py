"""A minimal CANopen master over python-can: NMT, SYNC producer, SDO client, heartbeat and PDO decoding.

Written from CiA 301 V4.2 without code of the gateway, so that the tests are independent of it. Needs Debian's
python3-can.
"""
import functools
import struct
import time

import can

# NMT commands and states (CiA 301, 7.2.8)
START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82
STATE_BOOT_UP, STATE_STOPPED, STATE_OPERATIONAL, STATE_PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F

NMT, SYNC, EMCY, SDO_TX, SDO_RX, HEARTBEAT = 0x000, 0x080, 0x080, 0x580, 0x600, 0x700
TPDO = 0x180, 0x280, 0x380, 0x480

SAVE, LOAD = b"save", b"load"


class Timeout(Exception):
    """The expected frame did not arrive in time."""


class Abort(Exception):
    """An SDO transfer was aborted by the server."""

    def __init__(self, index, sub, code):
        super().__init__("%04Xh:%02X aborted with %08Xh" % (index, sub, code))
        self.index, self.sub, self.code = index, sub, code


SDO_TIMED_OUT = 0x05040000


def again_after_a_timeout(transfer):
    """The server ends a transfer whose client is silent for a second, and on a busy machine this client can be."""
    @functools.wraps(transfer)
    def attempts(*args, **kwargs):
        for _ in range(4):
            try:
                return transfer(*args, **kwargs)
            except Abort as abort:
                if abort.code != SDO_TIMED_OUT:
                    raise
        return transfer(*args, **kwargs)

    return attempts


class ProtocolError(Exception):
    """The answer of the server violates CiA 301."""


class Master:
    """One bus, with all received frames in `frames` in bus order."""

    def __init__(self, bus, patience=120.0):
        self.bus = bus
        self.patience = patience  # timeout of an answer, s
        self.frames = []

    def close(self):
        self.bus.shutdown()

    def send(self, can_id, data=b""):
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def receive(self, timeout):
        """The next frame, or None."""
        frame = self.bus.recv(max(timeout, 0))
        if frame is not None:
            self.frames.append(frame)
        return frame

    def listen(self, seconds):
        """The frames of the next `seconds`."""
        first, end = len(self.frames), time.monotonic() + seconds
        while time.monotonic() < end:
            self.receive(end - time.monotonic())
        return self.frames[first:]

    def drain(self):
        """Discards the frames received so far."""
        while self.receive(0) is not None:
            pass
        self.frames.clear()

    def wait(self, wanted, timeout=None):
        """The next frame for which wanted(frame) is true; an integer is a CAN-ID."""
        if isinstance(wanted, int):
            can_id, wanted = wanted, lambda frame: frame.arbitration_id == can_id
        end = time.monotonic() + (self.patience if timeout is None else timeout)
        while True:
            frame = self.receive(end - time.monotonic())
            if frame is not None and not frame.is_error_frame and wanted(frame):
                return frame
            if time.monotonic() > end:
                raise Timeout("no such frame within %.1f s" % (self.patience if timeout is None else timeout))

    def collect(self, can_id, count):
        """The next `count` frames of that CAN-ID, however long a busy machine takes for them."""
        return [self.wait(can_id) for _ in range(count)]

    # ---- network management and SYNC

    def nmt(self, command, node):
        self.send(NMT, bytes([command, node]))

    def sync(self, counter=None):
        self.send(SYNC, b"" if counter is None else bytes([counter]))

    def wait_state(self, node, state, timeout=None):
        """Waits for a heartbeat (or boot-up) with this state."""
        return self.wait(lambda f: f.arbitration_id == HEARTBEAT + node and f.data == bytes([state]), timeout)

    # ---- SDO client (7.2.4.3): expedited and segmented

    def sdo_request(self, node, request):
        """Sends eight bytes and returns the next eight bytes of the server without checking them."""
        self.send(SDO_RX + node, request)
        answer = self.wait(SDO_TX + node)
        if answer.dlc != 8:
            raise ProtocolError("an SDO answer of %d bytes" % answer.dlc)
        return bytes(answer.data)

    def _transfer(self, node, index, sub, request):
        answer = self.sdo_request(node, request)
        if answer[0] == 0x80:
            aborted_index, aborted_sub, code = struct.unpack("<xHBI", answer)
            if (aborted_index, aborted_sub) != (index, sub):
                raise ProtocolError("abort names %04Xh:%02X" % (aborted_index, aborted_sub))
            raise Abort(index, sub, code)
        return answer

    @again_after_a_timeout
    def upload(self, node, index, sub=0):
        """Reads an object: its bytes."""
        multiplexer = struct.pack("<HB", index, sub)
        answer = self._transfer(node, index, sub, b"\x40" + multiplexer + bytes(4))
        command = answer[0]
        if command & 0xE0 != 0x40 or answer[1:4] != multiplexer:
            raise ProtocolError("answer %s to an upload" % answer.hex())
        if command & 0x02:  # expedited
            return answer[4:8 - (command >> 2 & 3)] if command & 0x01 else answer[4:]
        size = struct.unpack_from("<I", answer, 4)[0] if command & 0x01 else None
        data, toggle, last = b"", 0, False
        while not last:
            answer = self._transfer(node, index, sub, bytes([0x60 | toggle]) + bytes(7))
            if answer[0] & 0xF0 != toggle:
                raise ProtocolError("answer %s to segment with toggle %02Xh" % (answer.hex(), toggle))
            data += answer[1:8 - (answer[0] >> 1 & 7)]
            toggle ^= 0x10
            last = answer[0] & 0x01
        if size is not None and len(data) != size:
            raise ProtocolError("%d bytes announced, %d received" % (size, len(data)))
        return data

    @again_after_a_timeout
    def download(self, node, index, sub, data, segmented=False):
        """Writes an object: up to four bytes expedited, unless `segmented`."""
        multiplexer = struct.pack("<HB", index, sub)
        if 1 <= len(data) <= 4 and not segmented:
            request = bytes([0x23 | (4 - len(data)) << 2]) + multiplexer + data.ljust(4, b"\0")
        else:
            request = b"\x21" + multiplexer + struct.pack("<I", len(data))
        answer = self._transfer(node, index, sub, request)
        if answer[0] != 0x60 or answer[1:4] != multiplexer:
            raise ProtocolError("answer %s to a download" % answer.hex())
        if request[0] != 0x21:
            return
        toggle, rest = 0, data
        while True:
            segment, rest = rest[:7], rest[7:]
            command = toggle | (7 - len(segment)) << 1 | (not rest)
            answer = self._transfer(node, index, sub, bytes([command]) + segment.ljust(7, b"\0"))
            if answer[0] != 0x20 | toggle:
                raise ProtocolError("answer %s to a segment" % answer.hex())
            if not rest:
                return
            toggle ^= 0x10

    # ---- PDO

    def mapping(self, node, number):
        """The mapping of TPDO `number` (1..) in the device: [(index, sub, bits)]."""
        entries = self.upload(node, 0x1A00 + number - 1, 0)[0]
        words = [struct.unpack("<I", self.upload(node, 0x1A00 + number - 1, 1 + i))[0] for i in range(entries)]
        return [(word >> 16, word >> 8 & 0xFF, word & 0xFF) for word in words]

    def remap(self, node, number, entries, **communication):
        """The mapping procedure of 7.5.2.36: entries [(index, sub, bits)]; transmission=, inhibit= [100 us], event=
        [ms], start= are written while the PDO is invalid."""
        pdo, mapping = 0x1800 + number - 1, 0x1A00 + number - 1
        cob_id = struct.unpack("<I", self.upload(node, pdo, 1))[0]
        self.download(node, pdo, 1, struct.pack("<I", cob_id | 1 << 31))
        for name, sub, form in (
                ("transmission", 2, "<B"), ("inhibit", 3, "<H"), ("event", 5, "<H"), ("start", 6, "<B")):
            if name in communication:
                self.download(node, pdo, sub, struct.pack(form, communication[name]))
        if entries is not None:
            self.download(node, mapping, 0, b"\0")
            for i, (index, sub, bits) in enumerate(entries):
                self.download(node, mapping, 1 + i, struct.pack("<I", index << 16 | sub << 8 | bits))
            self.download(node, mapping, 0, bytes([len(entries)]))
        self.download(node, pdo, 1, struct.pack("<I", cob_id & ~(1 << 31)))


def decode(data, forms):
    """The values of a PDO; forms: one struct character each, e.g. "hhhH" (all little-endian, without gaps)."""
    if len(data) != struct.calcsize("<" + forms):
        raise ProtocolError("a PDO of %d bytes where %s was mapped" % (len(data), forms))
    return struct.unpack("<" + forms, data)


def emergency(frame):
    """(error code, error register, manufacturer's five bytes)."""
    if frame.dlc != 8:
        raise ProtocolError("an EMCY of %d bytes" % frame.dlc)
    return struct.unpack("<HB5s", frame.data)
