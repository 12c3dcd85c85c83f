"""Project URLs and a description with absolute links, for a build that knows where the project lies on GitHub.

That is a build by GitHub Actions in the project's own checkout (GITHUB_REPOSITORY is OWNER/NAME). Elsewhere there are
no URLs, and links are as in README.md. A wheel that is built from an sdist has what the sdist has.
"""

import os
import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface


class MetadataHook(MetadataHookInterface):
    """Sets `readme` and, where the repository is known, `urls`."""

    def update(self, metadata: dict) -> None:
        """Called by hatchling with the [project] table."""
        repository = self._repository()
        if "readme" not in metadata:
            text = Path(self.root, "README.md").read_text(encoding="utf-8")
            if repository:
                text = re.sub(
                    r"(!\[[^\]]*\]\()(?!\w+:|#)", rf"\1https://raw.githubusercontent.com/{repository}/main/", text
                )
                text = re.sub(r"(\]\()(?!\w+:|#)", rf"\1https://github.com/{repository}/blob/main/", text)
            metadata["readme"] = {"content-type": "text/markdown", "text": text}
        if repository and "urls" not in metadata:
            home = f"https://github.com/{repository}"
            metadata["urls"] = {
                "Repository": home,
                "Documentation": f"{home}/tree/main/docs",
                "Issues": f"{home}/issues",
                "Changelog": f"{home}/blob/main/CHANGELOG.md",
            }

    def _repository(self) -> str:
        """OWNER/NAME, or nothing: in a workflow of another project it is that project's."""
        elsewhere = Path(os.environ.get("GITHUB_WORKSPACE") or self.root).resolve() != Path(self.root).resolve()
        named = "" if elsewhere else os.environ.get("GITHUB_REPOSITORY", "")
        return named if re.fullmatch(r"[\w.-]+/[\w.-]+", named) else ""
