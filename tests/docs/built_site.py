"""The built site: links lead somewhere, nothing comes from elsewhere, search finds, and everybody can read it.

``make docs`` runs it after the build; pytest does not collect it by itself, because it needs build/site/html.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from conftest import ROOT
from lxml import html

SITE = ROOT / "build" / "site" / "html"
PAGES = sorted(path.relative_to(SITE).as_posix() for path in SITE.rglob("*.html") if "_static" not in path.parts)
SHOWN = (
    "index.html",
    "start.html",
    "tutorial/2_your_machine.html",
    "components/index.html",
    "components/BallscrewStage.html",
    "reference/index.html",
    "reference/commands/run.html",
    "reference/errors.html",
    "reference/fmu-contract.html",
    "reference/formats/system.html",
    "reference/python/cosim.html",
    "explanations/index.html",
    "explanations/integrator.html",
    "physics.html",
    "search.html",
)
"""Pages that are opened in a browser: one of each kind."""
QUESTIONS = {
    "lugre": ("components/BallscrewStage", "physics"),
    "step_multiple": ("reference/formats/system",),
    "overlay": ("reference/commands/run",),
    "sample delay": ("explanations/time-and-sampling",),
    "sensor noise": ("systems", "reference/formats/system"),
    "export ssp": ("reference/commands/export",),
    "timeout": ("explanations/containment", "reference/commands/run"),
    "fit interval": ("tutorial/2_your_machine", "reference/python/cosim.design.fit"),
    "own controller": ("tutorial/3_your_own_controller",),
    "simulink": ("use-in-your-tool",),
    "integrator tolerance": ("explanations/integrator",),
    "read_record": ("reference/python/cosim",),
    "noise": ("reference/formats/system",),
    "sampling_time": ("reference/formats/system",),
    "decimal comma": ("reference/formats/record",),
    "--overlay": ("reference/commands/run",),
    "exit code": ("reference/commands/index",),
    "settling time": ("reference/python/cosim.metrics",),
    "algebraic loop": ("reference/errors",),
    "unit does not match": ("reference/errors",),
    "fmi2DoStep": ("reference/fmu-contract",),
}
"""What a newcomer types into the search, and the pages that answer it; one of them is among the first five."""
LOADING = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src", "object": "data"}
"""Elements that a browser loads by themselves."""


@cache
def document(page: str) -> Any:
    return html.parse(str(SITE / page)).getroot()


@cache
def anchors(page: str) -> set[str]:
    return {*document(page).xpath("//@id"), *document(page).xpath("//a/@name")}


def test_there_is_a_site() -> None:
    assert len(PAGES) > 50, "python -m docs.build makes it"


def test_every_link_leads_somewhere() -> None:
    wrong: list[str] = []
    for page in PAGES:
        for target in document(page).xpath("//a/@href | //img/@src | //link/@href | //script/@src"):
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            path = (SITE / page).parent / unquote(parts.path) if parts.path else SITE / page
            if not path.is_file():
                wrong.append(f"{page}: {target}")
            elif path.suffix == ".html" and parts.fragment:
                to = path.resolve().relative_to(SITE).as_posix()
                if unquote(parts.fragment) not in anchors(to):
                    wrong.append(f"{page}: {target}: no such place")
    assert wrong == []


def test_nothing_is_loaded_from_elsewhere() -> None:
    wrong = [
        f"{page}: {address}"
        for page in PAGES
        for name, key in LOADING.items()
        for address in document(page).xpath(f"//{name}/@{key}")
        if urlsplit(address).netloc and document(page).xpath(f"//{name}[@{key}=$a][not(@rel='canonical')]", a=address)
    ]
    assert wrong == []


def test_every_picture_says_what_it_shows() -> None:
    """The small pictures of the tutorials stand beside their titles, and say no more."""
    wrong = [
        f"{page}: {picture.get('src')}"
        for page in PAGES
        for picture in document(page).xpath("//img[not(ancestor::*[contains(@class, 'sphx-glr-thumbcontainer')])]")
        if not (picture.get("alt") or "").strip() or (picture.get("alt") or "").endswith((".png", ".svg"))
    ]
    assert wrong == []


def test_no_page_names_a_folder_of_this_machine() -> None:
    folders = (str(ROOT), str(Path.home()))
    wrong = [page for page in PAGES for folder in folders if f"{folder}/" in (SITE / page).read_text(encoding="utf-8")]
    assert wrong == []


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
@pytest.mark.parametrize("name", SHOWN)
def test_pages_fit_and_everybody_can_read_them(browser: Any, name: str, scheme: str, width: int) -> None:
    from axe_playwright_python.sync_playwright import Axe

    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto((SITE / name).as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    found = Axe().run(page).response["violations"]
    serious = [
        f"{rule['id']}: {node['html'][:200]}"
        for rule in found
        if rule["impact"] in ("serious", "critical")
        for node in rule["nodes"][:3]
    ]
    assert serious == []
    assert [address for address in asked if not address.startswith(("file:", "data:"))] == []
    page.close()


def results(browser: Any, question: str) -> list[str]:
    """The pages that the search of the site lists, best first."""
    page = browser.new_page()
    page.goto(f"{(SITE / 'search.html').as_uri()}?q={question}")
    page.wait_for_selector("#search-results p.search-summary")
    page.wait_for_function(
        "document.querySelector('.search-summary').textContent.includes('found') ||"
        "document.querySelector('.search-summary').textContent.includes('match')"
    )
    addresses = page.eval_on_selector_all("#search-results li a", "links => links.map(link => link.href)")
    page.close()
    prefix = f"{SITE.as_uri()}/"
    return [urlsplit(address.removeprefix(prefix)).path.removesuffix(".html") for address in addresses]


@pytest.mark.parametrize("question", QUESTIONS)
def test_search_answers(browser: Any, question: str) -> None:
    first = results(browser, question)[:5]
    assert set(first) & set(QUESTIONS[question]), json.dumps(first)
