"""`sigmaswarm --completion`."""

from typing import Literal


def completion(shell: Literal["bash", "zsh", "fish", "powershell"], /) -> None:
    """Print what teaches a shell to complete commands, options and their values.

    It is printed, not installed: nothing is written where you did not ask for it.

    Examples:

        source <(sigmaswarm --completion bash)
        sigmaswarm --completion bash > ~/.local/share/bash-completion/completions/sigmaswarm
        sigmaswarm --completion fish > ~/.config/fish/completions/sigmaswarm.fish

    Parameters
    ----------
    shell
        The one that you use.
    """
    from sigmaswarm.cli.app import app

    print(app.generate_completion(shell=shell))
