"""What an engineer looks at before cutting: the report as one file of HTML, figures, and models for other programs."""
