"""The pure modules of the page, in node."""
import shutil
import subprocess
import unittest

import rig


@unittest.skipUnless(shutil.which("node"), "no node: apt-get install nodejs")
class Modules(unittest.TestCase):
    def test_the_modules_of_the_page_compute_what_is_known_of_them(self):
        done = subprocess.run(["node", "--test", str(rig.ROOT / "tests/page/modules.test.mjs")], capture_output=True,
                              text=True, timeout=rig.PATIENCE)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertNotIn("\n# pass 0\n", done.stdout)
