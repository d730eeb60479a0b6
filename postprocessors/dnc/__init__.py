"""Serial transfer of programs."""
