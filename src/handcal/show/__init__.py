"""What people see: words, pictures, pages, the terminal, the dashboard."""
