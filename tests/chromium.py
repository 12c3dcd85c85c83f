"""Pages in Chromium: one browser for all tests, light or dark, of any size."""

import contextlib
import shutil

import pytest

CONTRASTS = """
const luminance = colour => {
  const linear = v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const [r, g, b] = colour.match(/[0-9.]+/g).map(v => linear(v / 255));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const ground = e => {
  while (e && getComputedStyle(e).backgroundColor === "rgba(0, 0, 0, 0)") e = e.parentElement;
  return getComputedStyle(e || document.body).backgroundColor;
};
return [...document.querySelectorAll("h1,h2,p,span,b,label,summary,button,th,td,a,dt,dd,small,figcaption")]
  .filter(e => e.offsetParent && e.textContent.trim())
  .map(e => {
    const [a, b] = [getComputedStyle(e).color, ground(e)].map(luminance).sort((p, q) => p - q);
    return [e.textContent.trim().slice(0, 30), (b + 0.05) / (a + 0.05)];
  });
"""
"""WCAG contrast of every text that is shown."""


@pytest.fixture(scope="session")
def browser():
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs the extra 'dev'")
    binary, driver = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if not binary or not driver:
        pytest.skip("needs Chromium and chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for argument in ("headless=new", "no-sandbox", "disable-dev-shm-usage", "disable-gpu", "hide-scrollbars"):
        options.add_argument(f"--{argument}")
    options.add_argument("--window-size=1300,900")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with webdriver.Chrome(options=options, service=webdriver.ChromeService(driver)) as browser:
        yield browser


@contextlib.contextmanager
def screen(browser, scheme, size):
    """A window of this size whose user prefers light or dark; gives a function that runs a script in it."""
    shape = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size[0] < 600}
    preferred = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", shape)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": preferred})
    try:
        yield browser.execute_script
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
