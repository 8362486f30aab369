"""Shared by the tests of the page: gateways and imu9-web as processes, on a UDP bus of their own, and Chromium."""
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
BUILD = (ROOT / os.environ.get("BUILD", "build")).resolve()
WORK = pathlib.Path(tempfile.mkdtemp(prefix="imu9-page."))  # removed by `run`
BUS = "udp:239.74.163.2:%d" % (20000 + os.getpid() % 20000)
PATIENCE = 240  # for what must come, s: only a fault lets it pass

try:
    from selenium import webdriver
    from selenium.common.exceptions import StaleElementReferenceException
    from selenium.webdriver.chrome.service import Service
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import Select
except ImportError:
    webdriver = None

BROWSER = shutil.which("chromium")
DRIVER = shutil.which("chromedriver")
MISSING = None if webdriver and BROWSER and DRIVER else \
    "no browser: apt-get install chromium chromium-driver python3-selenium"


def program(name):
    return str(BUILD / name)


def sdo(node, *args):
    """What imu9-sdo prints."""
    done = subprocess.run([program("imu9-sdo"), "-i", BUS, "-n", str(node), "-t", "5000", *map(str, args)],
                          capture_output=True, text=True, timeout=PATIENCE)
    if done.returncode:
        raise AssertionError("imu9-sdo %s: %s" % (" ".join(map(str, args)), done.stderr))
    return done.stdout


def value(node, name):
    return float(sdo(node, "-q", "read", name))


def wait_until(condition, what="the condition"):
    """Returns the first value that is true."""
    end = time.monotonic() + PATIENCE
    while True:
        found = condition()
        if found:
            return found
        if time.monotonic() > end:
            raise AssertionError("%s: not within %d s" % (what, PATIENCE))
        time.sleep(0.1)


class Process:
    def __init__(self, *command):
        self.command = command
        self.log = WORK / ("%s.log" % tempfile.mktemp(dir=""))
        self.start()

    def start(self):
        with open(self.log, "a") as log:
            self.process = subprocess.Popen(self.command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def text(self):
        return self.log.read_text()

    def end(self, number=signal.SIGTERM):
        if self.process.poll() is None:
            self.process.send_signal(number)
            self.process.wait(PATIENCE)


class Gateway(Process):
    def __init__(self, node, imu, *args):
        self.node = node
        super().__init__(program("imu9-gateway"), "--imu", imu, "--can", BUS, "--node-id", str(node),
                         "--store", tempfile.mkdtemp(dir=WORK), *args)

    def wait(self):
        wait_until(lambda: "NMT state" in self.text(), "the gateway: " + self.text())
        return self


class Web(Process):
    """imu9-web, with `address` and `token`."""

    def __init__(self, *args):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        super().__init__(program("imu9-web"), "-i", BUS, "--listen", "127.0.0.1:%d" % self.port, *args)
        self.token = wait_until(lambda: re.search(r"^token: (\S+)", self.text(), re.M), "imu9-web: " + self.text())[1]
        self.address = "http://127.0.0.1:%d/" % self.port


def browser(width=1280, height=800, dark=False):
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars",
                     "--disable-background-networking", "--user-data-dir=" + tempfile.mkdtemp(dir=WORK)):
        options.add_argument(argument)
    options.add_experimental_option("prefs", {"download.default_directory": str(WORK)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(service=Service(DRIVER), options=options)
    driver.set_script_timeout(PATIENCE)
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {"width": width, "height": height,
                                                                 "deviceScaleFactor": 1, "mobile": width < 500})
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [
        {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]})
    return driver


@unittest.skipIf(MISSING, MISSING)
class OnThePage(unittest.TestCase):
    """Gateways (class attribute `nodes`: {node-ID: source}) and imu9-web for the class; a page for each test. The nodes
    are operational, and imu9-web produces SYNC at 100 Hz while the page is open."""

    nodes = {1: "sim:tumble"}
    size = 1280, 800

    @classmethod
    def setUpClass(cls):
        cls.gateways = {}
        for node, imu in cls.nodes.items():
            cls.gateways[node] = Gateway(node, imu)
            cls.addClassCleanup(cls.gateways[node].end)
        for gateway in cls.gateways.values():
            gateway.wait()
        cls.web = Web()
        cls.addClassCleanup(cls.web.end)

    def setUp(self):
        self.driver = browser(*self.size)
        self.addCleanup(self.driver.quit)
        for node in self.nodes:
            sdo(node, "nmt", "start")

    # ---- the page

    def open(self, route="", unlocked=True):
        self.driver.get(self.web.address + ("#token=" + self.web.token if unlocked else ""))
        for node in self.nodes:
            self.find('[data-node="%d"]' % node)
        if unlocked:
            self.until(lambda: "Unlocked" in self.find("#lock").text, "the page is unlocked")
        self.go(route)

    def go(self, route):
        self.driver.execute_script("location.hash = arguments[0]", "#/" + route)

    def produce_sync(self):
        self.go("bus")
        self.button("Produce").click()
        self.until(lambda: "SYNC" in self.text("#sync") and "No" not in self.text("#sync"), "a SYNC is heard")

    def until(self, condition, what):
        def tried():
            try:
                return condition()
            except StaleElementReferenceException:
                return None
        return wait_until(tried, what)

    def find(self, selector):
        """The first element, once it is there and shown."""
        def shown():
            return next((e for e in self.driver.find_elements(By.CSS_SELECTOR, selector) if e.is_displayed()), None)
        return self.until(shown, selector)

    def all(self, selector):
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def text(self, selector):
        """As it is in the document, whether it is on the screen or not."""
        return self.driver.execute_script(
            "return document.querySelector(arguments[0])?.textContent ?? ''", selector)

    def button(self, text, within="body"):
        return self.until(lambda: next((b for b in self.all(within + " button") if b.text == text and b.is_displayed()),
                                       None), "a button " + text)

    def number(self, selector):
        text = self.text(selector).replace("−", "-")
        found = re.search(r"-?\d+(?:\.\d+)?", text)
        return float(found[0]) if found else None

    def reading(self, signal_name, row):
        return self.number('[data-signal="%s"] tr:nth-child(%d) .number' % (signal_name, row))

    def write(self, name, text):
        """Searches the object in the view Objects and enters a value."""
        search = self.find('input[type="search"]')
        search.clear()
        search.send_keys(name)
        entry = self.find('[data-object="%s"] input' % name)
        self.until(lambda: entry.get_attribute("value") != "", "the value of " + name)
        entry.send_keys(Keys.CONTROL, "a")
        entry.send_keys(text, Keys.ENTER)
        self.until(lambda: "written" in self.text("#toasts"), name + " is written")
