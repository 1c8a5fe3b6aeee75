"""Compare settings over seeds: `python scripts/ablation.py [system=tras] [setting=direct,oracle] ['seed=range(5)']`."""

from cli import command
from train import train

main = command("ablation")(train)

if __name__ == "__main__":
    main()
