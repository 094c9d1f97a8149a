"""The help of a verb: its options in sections, what most people need first, and examples."""

from typing import Any

from typer.core import TyperCommand

ARGUMENTS, OPTIONS = "Arguments", "Options"


class Verb(TyperCommand):
    """A verb whose help lists its options under the panels that they name."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, the options without a panel, then panel by panel."""
        sections: dict[str, list[tuple[str, str]]] = {ARGUMENTS: [], OPTIONS: []}
        for one in self.get_params(ctx):
            row = one.get_help_record(ctx)
            if row is not None:
                usual = ARGUMENTS if one.param_type_name == "argument" else OPTIONS
                title = getattr(one, "rich_help_panel", None) or usual
                sections.setdefault(title, []).append(row)
        for title, rows in sections.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples."""
        from .examples import epilog

        self.epilog = epilog(self.name or "")
        super().format_epilog(ctx, formatter)
