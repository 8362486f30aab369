"""The page itself: what is sent, who may write, how it is used by keyboard and on a phone."""
import json
import unittest

import rig
from rig import sdo, value

try:
    import can
    import encoder
except ImportError:
    can = None
if not rig.MISSING:
    from selenium.webdriver.common.keys import Keys

VIEWS = ["bus", *("node/1/" + view for view in ("live", "objects", "calibration", "pdos", "configuration", "log"))]
CONTROLS = {"button", "link", "textbox", "searchbox", "combobox", "checkbox", "spinbutton", "tab", "tabpanel", "image",
            "progressbar", "navigation", "region", "tablist", "listbox"}


class FirstView(rig.OnThePage):
    def test_the_first_view_is_below_300_kB(self):
        self.driver.get("about:blank")
        self.driver.get_log("performance")  # of the browser's own page
        self.open("node/1/live")
        self.until(lambda: self.driver.execute_script("return typeof Chart !== 'undefined'"), "the charts are loaded")
        sizes, urls = {}, {}
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.responseReceived":
                urls[message["params"]["requestId"]] = message["params"]["response"]["url"]
            elif message["method"] == "Network.loadingFinished":
                sizes[message["params"]["requestId"]] = message["params"]["encodedDataLength"]
        loaded = {urls[key]: size for key, size in sizes.items() if key in urls}
        self.assertTrue(any(url.endswith("/chart.min.js") for url in loaded), loaded)
        self.assertTrue(any(url.endswith("/strings.js") for url in loaded), loaded)
        self.assertLess(sum(loaded.values()), 300e3, loaded)
        self.assertEqual({url for url in loaded if not url.startswith(self.web.address)}, set(),
                         "something came from elsewhere")


class Token(rig.OnThePage):
    def ask(self):
        """Lets the page write without having the token."""
        self.open("node/1/objects", unlocked=False)
        self.find('input[type="search"]').send_keys("lever_arm.t")
        entry = self.find('[data-object="lever_arm.t"] input')
        self.until(lambda: entry.get_attribute("value") != "", "the value")
        entry.send_keys(Keys.CONTROL, "a")
        entry.send_keys("0.25", Keys.ENTER)
        return self.find("#token")

    def test_without_the_token_nothing_is_written(self):
        token = self.ask()
        token.send_keys("0123456789", Keys.ENTER)
        self.until(lambda: self.text("dialog .error") != "", "the token is refused")
        self.assertEqual(value(1, "lever_arm.t"), 0)

    def test_with_the_token_the_write_goes_on(self):
        token = self.ask()
        token.send_keys(self.web.token, Keys.ENTER)
        self.until(lambda: "written" in self.text("#toasts"), "it is written")
        self.assertEqual(value(1, "lever_arm.t"), 0.25)
        sdo(1, "write", "lever_arm.t", 0)

    def test_a_token_in_the_address_unlocks_and_is_removed_from_it(self):
        self.open()
        self.assertNotIn("token", self.driver.current_url)
        self.assertNotIn("token", self.driver.execute_script("return location.href + document.referrer"))


class Everywhere(rig.OnThePage):
    def test_no_view_reports_an_error_or_violates_the_security_policy(self):
        self.open()
        for view in VIEWS:
            self.go(view)
            self.find("#view > *")
        self.produce_sync()
        self.go("node/1/live")
        self.until(lambda: self.number('[data-fact="pdo_rate"]'), "PDOs come")
        self.assertEqual([entry for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"], [])

    def test_every_control_has_a_name_for_a_screen_reader(self):
        self.open()
        for view in VIEWS:
            self.go(view)
            self.find("#view > *")
            if view.endswith("objects"):
                self.find('input[type="search"]').send_keys("lever_arm")
                self.find('[data-object="lever_arm_model"] select')
            nodes = self.driver.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
            found = [node for node in nodes if not node["ignored"] and node["role"]["value"] in CONTROLS]
            self.assertGreater(len(found), 10, view)
            nameless = [node for node in found if not node.get("name", {}).get("value", "").strip()]
            self.assertEqual([(node["role"], node.get("properties")) for node in nameless], [], view)

    def test_arrow_keys_go_through_the_tabs(self):
        self.open("node/1/live")
        self.find("#tab-live").send_keys(Keys.ARROW_RIGHT)
        self.until(lambda: self.driver.switch_to.active_element.get_attribute("id") == "tab-objects", "the next tab")
        self.find('input[type="search"]')
        self.find("#tab-objects").send_keys(Keys.HOME)
        self.find(".scene")

    def test_an_emergency_is_announced_in_words(self):
        self.open("node/1/log")
        sdo(1, "write", "slope_range.longitudinal", 5)
        self.addCleanup(sdo, 1, "write", "slope_range.longitudinal", 0)
        self.until(lambda: "5010h" in self.text("#announce"), "the EMCY")
        self.assertRegex(self.text("#announce"), r"Node 1: EMCY 5010h: \w+ \w+")
        self.until(lambda: "5010h" in self.text(".events"), "it is in the list")


class OnAPhone(rig.OnThePage):
    size = 390, 844

    def test_nothing_is_wider_than_the_screen(self):
        self.open()
        for view in VIEWS:
            self.go(view)
            self.find("#view > *")
            self.until(lambda: self.text("#view").strip(), view)
            width = self.driver.execute_script("return document.scrollingElement.scrollWidth")
            self.assertLessEqual(width, 390, view)


@unittest.skipIf(can is None, "no python3-can: apt-get install python3-can python3-msgpack")
class AnotherVendor(rig.OnThePage):
    nodes = {}

    @classmethod
    def setUpClass(cls):
        cls.eds = rig.WORK / "encoder.eds"
        cls.eds.write_text(encoder.EDS)
        cls.device = encoder.Encoder(rig.BUS)
        cls.device.start()
        cls.addClassCleanup(cls.device.end)
        cls.web = rig.Web("--eds", str(cls.eds))
        cls.addClassCleanup(cls.web.end)

    def test_a_device_of_another_vendor_has_its_objects_and_no_views_of_an_imu(self):
        self.open("bus")
        link = self.find('[data-node="42"]')
        self.until(lambda: "ENC7" in self.text('[data-node="42"]'), "its name")
        link.click()
        seen = set()
        self.until(lambda: seen.add(self.number("#view tbody .number")) or len(seen) > 5, "its position moves")
        self.assertIn("Position value", self.text("#view tbody"))
        self.assertEqual([tab.text for tab in self.all("#tabs a")], ["Live", "Objects", "PDOs", "Configuration", "Log"])
        self.assertEqual(self.all(".scene"), [])
        self.go("node/42/objects")
        self.find('input[type="search"]').send_keys("position")
        self.until(lambda: int(self.number('[data-object="position_value"] output') or 0) > 0, "it is read by SDO")
        self.go("node/42/pdos")
        self.find('[data-pdo="1"] [data-entry="position_value"]')
